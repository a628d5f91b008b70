# SPDX-License-Identifier: GPL-3.0-or-later
"""How close two images of one view are, as a protocol has it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..io.srgb import decode_srgb, encode_srgb
from . import metrics
from .ground_truth import Truth
from .lpips import Lpips
from .protocols import Protocol

Metrics = Mapping[str, Lpips]  # suffix of the figure's name ("", "_alex") -> the perceptual distance
HDR_PEAK = 4.0


def image_figures(kind: str, rgba: np.ndarray, true: np.ndarray, truth: Truth, how: Protocol, lpips: Metrics) -> dict[str, float]:
    """Figures of an image (H, W, 4), linear premultiplied, against the true one (H, W, 3), encoded and times its alpha, of that view.

    `kind`: "nvs", "radiance" or "relight", see `Protocol.cut`.
    """
    if how.radiance:
        return _radiance_figures(rgba, true, truth, lpips)
    ours, true = shown(kind, rgba, truth, how), shown_truth(true, truth, how)
    figures = _alike(ours, true, lpips)
    if truth.object.any():
        figures["psnr_object"] = metrics.psnr(ours, true, truth.object)
    if how.fitted:
        scaled = _alike(ours * metrics.fitted_scale(ours, true), true, lpips)
        figures |= {f"{name}_scaled": value for name, value in scaled.items()}
    return figures


def shown(kind: str, rgba: np.ndarray, truth: Truth, how: Protocol) -> np.ndarray:
    """(H, W, 3) encoded: our linear premultiplied image of some kind on the protocol's background."""
    if how.radiance:
        return metrics.on_black(rgba)
    alpha = np.clip(np.nan_to_num(rgba[..., 3:].astype(np.float64)), 0, 1)
    ours, silhouette = metrics.on_black(rgba), how.silhouette if kind in how.cut else "own"
    if silhouette == "hard":
        ours = np.where(alpha > 0.5, ours / np.maximum(alpha, 0.5), how.background)
    else:
        ours = ours + how.background * (1 - alpha)
    if silhouette == "true":
        ours = ours * truth.alpha[..., None]
    return _rounded(ours) if how.eight_bit else ours


def shown_truth(true: np.ndarray, truth: Truth, how: Protocol) -> np.ndarray:
    """(H, W, 3) encoded: the true image, on black, on the protocol's background."""
    background = 0.0 if how.radiance else how.background
    true = np.clip(true.astype(np.float64), 0, 1) + background * (1 - truth.alpha[..., None])
    return _rounded(true) if how.eight_bit else true


def _rounded(image: np.ndarray) -> np.ndarray:
    return np.round(image * 255) / 255


def _alike(ours: np.ndarray, true: np.ndarray, lpips: Metrics) -> dict[str, float]:
    figures = {"psnr": metrics.psnr(ours, true), "ssim": metrics.ssim(ours, true)}
    return figures | {f"lpips{suffix}": distance(np.clip(ours, 0, 1), np.clip(true, 0, 1)) for suffix, distance in lpips.items()}


# --- Stanford-ORB


def _radiance_figures(rgba: np.ndarray, true: np.ndarray, truth: Truth, lpips: Metrics) -> dict[str, float]:
    inside = metrics.eroded(truth.alpha > 0.5)
    alpha = np.maximum(truth.alpha, 1e-6)[..., None]
    linear = decode_srgb(true.astype(np.float64) / alpha) * inside[..., None]
    ours = np.clip(np.nan_to_num(rgba[..., :3].astype(np.float64)), 0, None) * inside[..., None]
    ours = ours * metrics.fitted_scale(ours, linear)
    brightness = _brightness(linear)
    bright, true_bright = (np.clip(brightness * image, 0, HDR_PEAK) for image in (ours, linear))
    low, true_low = (encode_srgb(np.clip(image, 0, 1)) for image in (ours, linear))
    figures = {
        "psnr_hdr": floored_psnr(bright, true_bright, inside),
        "psnr_ldr": floored_psnr(low, true_low, inside),
        "ssim": metrics.ssim(low, true_low, 3),
    }
    return figures | {f"lpips{suffix}": distance(encode_srgb(low), encode_srgb(true_low)) for suffix, distance in lpips.items()}


def _brightness(linear: np.ndarray) -> float:
    """How much brighter the sRGB curve makes an image on average."""
    mean = np.clip(linear, 0, 1).mean()
    return float(encode_srgb(np.clip(linear, 0, 1)).mean() / mean) if mean > 1e-8 else 1.0


def floored_psnr(ours: np.ndarray, true: np.ndarray, inside: np.ndarray) -> float:
    """PSNR over the whole image, not below that of a middle grey on the object."""
    grey = np.repeat(0.5 * inside[..., None], 3, -1)
    return max(metrics.psnr(ours, true), metrics.psnr(grey, true))
