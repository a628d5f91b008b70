# SPDX-License-Identifier: GPL-3.0-or-later
"""Image metrics of one view: PSNR, SSIM and LPIPS, with the background, silhouette and encoding that a protocol prescribes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..io.srgb import decode_srgb, encode_srgb
from . import metrics
from .ground_truth import Truth
from .lpips import Lpips
from .protocols import Protocol

LpipsBySuffix = Mapping[str, Lpips]  # suffix of the metric's name ("", "_alex") -> perceptual distance
HDR_PEAK = 4.0  # linear values are clipped to it


def image_metrics(
    kind: str, rgba: np.ndarray, true: np.ndarray, truth: Truth, protocol: Protocol, lpips: LpipsBySuffix
) -> dict[str, float]:
    """Return the metrics of one image of a view.

    Args:
        kind: of image, "nvs", "radiance" or "relight", see `Protocol.cut`.
        rgba: (H, W, 4), estimated, linear premultiplied.
        true: (H, W, 3), encoded, times its alpha.
        truth: of the view.
        protocol: how images are compared.
        lpips: perceptual distances.
    """
    if protocol.radiance:
        return _radiance_metrics(rgba, true, truth, lpips)
    ours, true = prepare_image(kind, rgba, truth, protocol), prepare_truth(true, truth, protocol)
    values = _similarity(ours, true, lpips)
    if truth.object.any():
        values["psnr_object"] = metrics.psnr(ours, true, truth.object)
    if protocol.fitted:
        scaled = _similarity(ours * metrics.fitted_scale(ours, true), true, lpips)
        values |= {f"{name}_scaled": value for name, value in scaled.items()}
    return values


def prepare_image(kind: str, rgba: np.ndarray, truth: Truth, protocol: Protocol) -> np.ndarray:
    """Return our image as the protocol compares it: (H, W, 3), sRGB-encoded, on its background, with its silhouette.

    Args:
        kind: of image, "nvs", "radiance" or "relight", see `Protocol.cut`.
        rgba: (H, W, 4), linear premultiplied.
        truth: of the view.
        protocol: its background, silhouette and bit depth are applied.
    """
    if protocol.radiance:
        return metrics.on_black(rgba)
    alpha = np.clip(np.nan_to_num(rgba[..., 3:].astype(np.float64)), 0, 1)
    ours, silhouette = metrics.on_black(rgba), protocol.silhouette if kind in protocol.cut else "own"
    if silhouette == "hard":
        ours = np.where(alpha > 0.5, ours / np.maximum(alpha, 0.5), protocol.background)
    else:
        ours = ours + protocol.background * (1 - alpha)
    if silhouette == "true":
        ours = ours * truth.alpha[..., None]
    return _rounded(ours) if protocol.eight_bit else ours


def prepare_truth(true: np.ndarray, truth: Truth, protocol: Protocol) -> np.ndarray:
    """Return the true image as the protocol compares it: (H, W, 3), sRGB-encoded, on its background.

    Args:
        true: (H, W, 3), encoded, times its alpha.
        truth: of the view.
        protocol: its background and bit depth are applied.
    """
    background = 0.0 if protocol.radiance else protocol.background
    true = np.clip(true.astype(np.float64), 0, 1) + background * (1 - truth.alpha[..., None])
    return _rounded(true) if protocol.eight_bit else true


def _rounded(image: np.ndarray) -> np.ndarray:
    return np.round(image * 255) / 255


def _similarity(ours: np.ndarray, true: np.ndarray, lpips: LpipsBySuffix) -> dict[str, float]:
    """Return PSNR, SSIM and LPIPS of two encoded images (H, W, 3)."""
    values = {"psnr": metrics.psnr(ours, true), "ssim": metrics.ssim(ours, true)}
    return values | {f"lpips{suffix}": distance(np.clip(ours, 0, 1), np.clip(true, 0, 1)) for suffix, distance in lpips.items()}


# --- Stanford-ORB


def _radiance_metrics(rgba: np.ndarray, true: np.ndarray, truth: Truth, lpips: LpipsBySuffix) -> dict[str, float]:
    """Compare linear radiance inside the eroded true mask, after a least-squares scale per channel (Stanford-ORB)."""
    inside = metrics.eroded(truth.alpha > 0.5)
    alpha = np.maximum(truth.alpha, 1e-6)[..., None]
    linear = decode_srgb(true.astype(np.float64) / alpha) * inside[..., None]
    ours = np.clip(np.nan_to_num(rgba[..., :3].astype(np.float64)), 0, None) * inside[..., None]
    ours = ours * metrics.fitted_scale(ours, linear)
    brightness = _brightness(linear)
    bright, true_bright = (np.clip(brightness * image, 0, HDR_PEAK) for image in (ours, linear))
    low, true_low = (encode_srgb(np.clip(image, 0, 1)) for image in (ours, linear))
    values = {
        "psnr_hdr": floored_psnr(bright, true_bright, inside),
        "psnr_ldr": floored_psnr(low, true_low, inside),
        "ssim": metrics.ssim(low, true_low, 3),
    }
    return values | {f"lpips{suffix}": distance(encode_srgb(low), encode_srgb(true_low)) for suffix, distance in lpips.items()}


def _brightness(linear: np.ndarray) -> float:
    """Return the factor by which the sRGB curve brightens a linear image (H, W, 3) on average."""
    mean = np.clip(linear, 0, 1).mean()
    return float(encode_srgb(np.clip(linear, 0, 1)).mean() / mean) if mean > 1e-8 else 1.0


def floored_psnr(ours: np.ndarray, true: np.ndarray, inside: np.ndarray) -> float:
    """Return the PSNR in dB over the whole image, at least that of a middle grey on the object (Stanford-ORB).

    Args:
        ours: (H, W, 3).
        true: (H, W, 3).
        inside: (H, W) bool, pixels of the object.
    """
    grey = np.repeat(0.5 * inside[..., None], 3, -1)
    return max(metrics.psnr(ours, true), metrics.psnr(grey, true))
