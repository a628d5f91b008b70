# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation protocols of published papers: each one's choices where a metric of one name can be computed in several ways."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..errors import InputError

Silhouette = Literal["own", "true", "hard", "eroded"]
ScaleFit = Literal["median", "least squares"]

SILHOUETTES = {
    "own": "by their own alpha, so that a wrong silhouette counts as an error",
    "true": "by their own alpha and then times the true one",
    "hard": "opaque where their own alpha is above 0.5 and absent elsewhere",
    "eroded": "cut out by the true mask, made smaller by 2 pixels",
}
SCALE_PIXELS = {
    "covered": "true alpha above 0.5",
    "lit": "true alpha and every true channel above 0",
    "any": "true alpha above 0",
    "eroded": "the true mask made smaller by 2 pixels",
}


@dataclass(frozen=True)
class Protocol:
    """Choices behind one paper's tables; the names of the metrics are the same in all.

    Attributes:
        name: of the protocol.
        follows: paper whose tables these are.
        samples: light samples per pixel of a shaded or relit image.
        radiance: images are compared by Stanford-ORB's measures of linear radiance (psnr_hdr, psnr_ldr), scaled; otherwise sRGB-encoded.
        background: grey value behind encoded images, 0 or 1.
        silhouette: a key of SILHOUETTES, of our images of the kinds in `cut`; those of the other kinds have "own".
        cut: kinds of images ("nvs": under the recovered light, "radiance": by the Gaussians' own radiance, "relight").
        eight_bit: encoded images are rounded to 8 bits first.
        fitted: images are compared after a scale of each one's channels as well.
        relit_views: at most so many of the first views are relit; None: all.
        relit_scaled: relit with the albedo times the scale; otherwise as estimated.
        scale: fit of the albedo's scale per channel.
        scale_pixels: pixels that it is fitted on, a key of SCALE_PIXELS.
        scale_views: number of views that it is fitted on; None: all.
        scale_each_view: every view has its own albedo scale, and no image is relit with it.
        albedo_white: albedo is set on white outside the true mask, clipped, and its PSNR taken at 1/2.2 power, pooled over all views;
            otherwise on black, linear, the mean of the views'.
        blended_normals: over the full image, normals fade to +Z with alpha; otherwise a pixel without a true normal counts as no error.
        scale_free: depth up to one factor of all views (depth_si_mse), cosine distance of normals, squared Chamfer distance.
        light_grid: rows and columns on which light maps are compared; None: those of the true map.
        lpips: networks of the perceptual distance; the first has no suffix in the metrics' names.
    """

    name: str
    follows: str
    samples: int = 512
    radiance: bool = False
    background: float = 0.0
    silhouette: Silhouette = "own"
    cut: tuple[str, ...] = ("nvs", "radiance", "relight")
    eight_bit: bool = False
    fitted: bool = False
    relit_views: int | None = None
    relit_scaled: bool = True
    scale: ScaleFit = "median"
    scale_pixels: Literal["covered", "lit", "any", "eroded"] = "covered"
    scale_views: int | None = None
    scale_each_view: bool = False
    albedo_white: bool = False
    blended_normals: bool = False
    scale_free: bool = False
    light_grid: tuple[int, int] | None = None
    lpips: tuple[str, ...] = ("vgg",)


PLAIN = Protocol("plain", "this program's own", samples=64)
PROTOCOLS = {
    one.name: one
    for one in (
        PLAIN,
        Protocol(
            "tensoir",
            "TensoIR (CVPR 2023), its published evaluation code",
            background=1.0,
            silhouette="hard",
            cut=("nvs", "relight"),
            scale_pixels="any",
            scale_views=20,
            albedo_white=True,
            blended_normals=True,
            lpips=("vgg", "alex"),
        ),
        Protocol(
            "irgs",
            "IRGS (CVPR 2025) on TensoIR's scenes, its published evaluation code",
            silhouette="true",
            cut=("relight",),
            scale_pixels="lit",
            blended_normals=True,
        ),
        Protocol(
            "glossy",
            "GS-ROR on GlossySynthetic, its published evaluation code",
            background=1.0,
            eight_bit=True,
            fitted=True,
            relit_views=16,
            relit_scaled=False,
            light_grid=(256, 512),
        ),
        Protocol(
            "stanford-orb",
            "Stanford-ORB (NeurIPS 2023), its published evaluation code",
            radiance=True,
            silhouette="eroded",
            relit_scaled=False,
            scale="least squares",
            scale_pixels="eroded",
            scale_each_view=True,
            scale_free=True,
        ),
    )
}


def protocol_named(name: str) -> Protocol:
    """Return one of PROTOCOLS; raises InputError for another name."""
    if name not in PROTOCOLS:
        raise InputError("--protocol", f"there is no {name}", f"use {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


def describe_protocol(protocol: Protocol) -> list[str]:
    """Describe every choice in lines of text: metrics are comparable only where these agree."""
    return [
        f"Protocol {protocol.name}: {protocol.follows}.",
        _images(protocol),
        _relit(protocol),
        _albedo(protocol),
        _geometry(protocol),
        _light(protocol),
    ]


def _images(protocol: Protocol) -> str:
    cut = SILHOUETTES[protocol.silhouette]
    if protocol.radiance:
        return (
            f"Images: {cut}, after a least-squares scale per channel and image. psnr_hdr: linear, both first made brighter by what the "
            "sRGB curve does to the true one's mean, clipped to 0..4; psnr_ldr: sRGB-encoded, clipped to 0..1; errors are means over the "
            "whole image, and no PSNR is below that of a middle grey. SSIM with a window of 3 pixels; LPIPS of images encoded twice, "
            "as that code has it. Means over the views, then over the lights."
        )
    if protocol.silhouette != "own" and len(protocol.cut) < 3:
        cut = f"{SILHOUETTES['own']}, except {', '.join(f'{kind}_*' for kind in protocol.cut)}: {cut}"
    bits = ", rounded to 8 bits" if protocol.eight_bit else ""
    ground = "white" if protocol.background else "black"
    fitted = "; *_scaled after a least-squares scale per channel and image over all pixels, not clipped" if protocol.fitted else ""
    return f"Images: sRGB-encoded, clipped to 0..1{bits}, on {ground}, {cut}{fitted}; means over the views, then over the lights."


def _relit(protocol: Protocol) -> str:
    albedo = "times that scale" if protocol.relit_scaled else "as estimated"
    views = f"the first {protocol.relit_views} views under each light" if protocol.relit_views else "all views"
    return f"Relit images: albedo {albedo}, {views}. Images under the recovered light: albedo as estimated."


def _albedo(protocol: Protocol) -> str:
    of = "its view's alone" if protocol.scale_each_view else f"{protocol.scale_views} views" if protocol.scale_views else "all views"
    fit = "median of true / estimated" if protocol.scale == "median" else "least squares"
    scale = f"one scale per channel, the {fit} over the pixels ({SCALE_PIXELS[protocol.scale_pixels]}) of {of}"
    if protocol.albedo_white:
        return f"Albedo: white outside the true mask, clipped to 0..1, after {scale}; PSNR at the power 1/2.2, pooled over all views."
    cut = f"clipped to 0..1, {SILHOUETTES['eroded']}" if protocol.radiance else "times the true alpha, on black"
    return f"Albedo: linear, {cut}, after {scale}; means of the views."


def _geometry(protocol: Protocol) -> str:
    if protocol.blended_normals:
        full = "normal_mae_full over the whole image, where both fade to +Z with their own alpha"
    else:
        full = "normal_mae_full over the whole image, the background counted as no error"
    text = f"Normals: normal_mae over the object (true alpha above 0.99), {full}"
    if protocol.scale_free:
        text += (
            "; normal_cosine is 1 - cosine over the true mask made smaller by 2 pixels. Depth: depth_si_mse, after one least-squares "
            "factor for all views, over the whole image. Shape: shape_chamfer, half the sum of the mean squared distances from mesh to "
            "truth and back, times 2000, 30 000 points on each (that code takes the scan's vertices). Both in the dataset's units"
        )
    return text + "."


def _light(protocol: Protocol) -> str:
    grid = f"a grid of {protocol.light_grid[1]}x{protocol.light_grid[0]}" if protocol.light_grid else "the true map's grid"
    return (
        f"Environment, measured in this program's own way: on {grid}, one least-squares scale per channel weighted by solid angle, "
        "sRGB-encoded, clipped to 0..1; environment_psnr_unscaled without the scale; environment_psnr_constrained over the part of the "
        "sphere that the photographs constrain, with a scale that is fitted there."
    )
