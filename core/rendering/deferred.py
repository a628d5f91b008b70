# SPDX-License-Identifier: GPL-3.0-or-later
"""From rasterised sums to the image a camera takes: normalise, reflect the light, composite."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..io.srgb import encode_srgb
from ..kernels.rasterize import COLOUR, EXTRA, NORMAL
from ..machine.backend import by_warp
from ..shading.environment_lookup import lookup
from ..shading.split_sum import specular_light, specular_radiance

ALPHA_FLOOR = 1e-4  # below it nothing is there to be normalised
REFLECTING = 0.05  # opacity from which a pixel reflects; fainter ones show their SH colour


@dataclass
class SurfacePixels:
    """The covered pixels of an image as surface points; P of them.

    Attributes:
        index: (P,) flat pixel index.
        view: (P, 3) unit, towards the camera. normal: (P, 3) unit.
        colour, albedo: (P, 3); roughness, metallic, alpha: (P,).
    """

    index: torch.Tensor
    view: torch.Tensor
    normal: torch.Tensor
    colour: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor
    alpha: torch.Tensor


def surface_pixels(image: torch.Tensor, rays: torch.Tensor, threshold: float = REFLECTING, every: bool = False) -> SurfacePixels:
    """Divide the sums of `rasterize` (13, H, W; extras: albedo, roughness, metallic) by opacity where it exceeds `threshold`.

    rays: (3, H, W) world directions of any length. every: all pixels, fainter ones divided by the threshold: nobody has to wait for
    their number.
    """
    flat = image.flatten(1)
    index = torch.arange(flat.shape[1], device=flat.device) if every else torch.nonzero(flat[-1].detach() > threshold)[:, 0]
    at = flat if every else flat[:, index]
    mean = at[:-1] / (at[-1].clamp_min(threshold) if every else at[-1])
    view = -torch.nn.functional.normalize(rays.flatten(1)[:, index], dim=0).T
    normal = torch.nn.functional.normalize(mean[NORMAL], dim=0).T
    colour, albedo = mean[COLOUR].T, mean[EXTRA : EXTRA + 3].T
    return SurfacePixels(index, view, normal, colour, albedo, mean[EXTRA + 3], mean[EXTRA + 4], at[-1])


def splat_radiance(image: torch.Tensor) -> torch.Tensor:
    """(3, H, W) straight linear radiance of the SH colours."""
    return image[COLOUR] / image[-1:].clamp_min(ALPHA_FLOOR)


def reflective_radiance(image: torch.Tensor, rays: torch.Tensor, stack: torch.Tensor) -> torch.Tensor:
    """(3, H, W) straight linear radiance (1 - m) C_sh + split-sum reflection of the light (Ref-Gaussian, in linear light)."""
    every = by_warp(image)
    p = surface_pixels(image, rays, every=every)
    light = specular_radiance(p.view, p.normal, p.albedo, p.roughness, p.metallic, stack)
    shaded = (1 - p.metallic[:, None]) * p.colour + light
    base = splat_radiance(image)
    if every:
        return torch.where(image[-1] > REFLECTING, shaded.T.view_as(base), base)
    return base.flatten(1).index_copy(1, p.index, shaded.T).view_as(base)


def radiance(image: torch.Tensor, rays: torch.Tensor, light: torch.Tensor | None) -> torch.Tensor:
    """(3, H, W) straight linear radiance; `light` (H, W, 3) switches the reflections on."""
    return splat_radiance(image) if light is None else reflective_radiance(image, rays, specular_light(light))


def background_radiance(background: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    """(3, H, W) linear radiance of a lat-long background (h, w, 3) along world rays (3, H, W)."""
    direction = torch.nn.functional.normalize(rays.flatten(1), dim=0).T
    return lookup(background, direction).T.view_as(rays)


def composite(straight: torch.Tensor, alpha: torch.Tensor, rays: torch.Tensor, background: torch.Tensor | None) -> torch.Tensor:
    """(3, H, W) encoded image, on black where masks tell object from background, else on the learned background (in linear light)."""
    if background is None:
        return encode_srgb(straight) * alpha
    return encode_srgb(straight * alpha + background_radiance(background, rays) * (1 - alpha))
