# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo metrics: only albedo times light is observed, so every protocol scales the albedo first, each in its own way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..io.srgb import encode_srgb
from . import metrics
from .ground_truth import Truth
from .image_metrics import LpipsBySuffix, floored_psnr
from .prediction import Prediction
from .protocols import Protocol

GAMMA = 2.2
Sample = tuple[np.ndarray, np.ndarray]  # pixels (N, 3) linear: estimated, true


def scale_sample(prediction: Prediction, truth: Truth, protocol: Protocol) -> Sample | None:
    """Return the pixels (N, 3) of a view that the albedo's scale is computed from, estimated and true, linear.

    Args:
        prediction: of the view.
        truth: of the view.
        protocol: which pixels these are.

    Returns:
        None where the view's true albedo is not known.
    """
    if truth.albedo is None:
        return None
    albedo, true = prediction.layer("albedo"), truth.albedo
    if protocol.albedo_white:
        albedo, true = _on_white(albedo, prediction.buffers.alpha), _on_white(true, truth.alpha)
    mask = _scale_mask(truth, protocol)
    return albedo[mask], true[mask]


def scale_of(samples: Sequence[Sample | None], protocol: Protocol) -> np.ndarray | None:
    """Return the albedo's factor per channel (3,) that is common to all views.

    Args:
        samples: of all views, from `scale_sample`.
        protocol: how the scale is fitted, and on how many of the views.

    Returns:
        None where no true albedo is known or each view has its own scale.
    """
    chosen = list(samples)
    if protocol.scale_views is not None and len(chosen) > protocol.scale_views:
        chosen = [chosen[i * (len(chosen) // protocol.scale_views)] for i in range(protocol.scale_views)]
    known = [sample for sample in chosen if sample is not None]
    return None if protocol.scale_each_view or not known else _scale(known, protocol)


def albedo_row(
    prediction: Prediction, truth: Truth, scale: np.ndarray | None, protocol: Protocol, lpips: LpipsBySuffix
) -> dict[str, float]:
    """Return the albedo metrics of one view; empty where its true albedo is not known.

    Args:
        prediction: of the view.
        truth: of the view.
        scale: (3,) of all views, from `scale_of`; None: this view's own.
        protocol: how albedo is compared.
        lpips: perceptual distances.
    """
    sample = scale_sample(prediction, truth, protocol)
    if sample is None or truth.albedo is None:
        return {}
    scale = _scale([sample], protocol) if scale is None else scale
    if protocol.radiance:
        return _masked_row(prediction, truth, scale, lpips)
    if protocol.albedo_white:
        return _white_row(prediction, truth, scale, lpips)
    alpha = truth.alpha[..., None]
    albedo, true = prediction.layer("albedo") * alpha, truth.albedo * alpha
    row = {"albedo_psnr": metrics.psnr(albedo * scale, true), "albedo_psnr_unscaled": metrics.psnr(albedo, true)}
    row |= {"albedo_psnr_object": metrics.psnr(albedo * scale, true, truth.object)} if truth.object.any() else {}
    return row | _structure(albedo * scale, true, lpips)


def _scale(samples: Sequence[Sample], protocol: Protocol) -> np.ndarray:
    everywhere = [np.ones(len(ours), bool) for ours, _ in samples]
    return metrics.albedo_scale([ours for ours, _ in samples], [true for _, true in samples], everywhere, protocol.scale)


def _scale_mask(truth: Truth, protocol: Protocol) -> np.ndarray:
    """Return the pixels (H, W) bool that the scale is computed from, see SCALE_PIXELS in protocols.py."""
    assert truth.albedo is not None
    if protocol.scale_pixels == "covered":
        return truth.alpha > 0.5
    if protocol.scale_pixels == "eroded":
        return metrics.eroded(truth.alpha > 0.5)
    return (truth.alpha > 0) & ((truth.albedo > 0).all(-1) if protocol.scale_pixels == "lit" else True)


def _on_white(albedo: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return albedo * alpha[..., None] + 1 - alpha[..., None]


def _white_row(prediction: Prediction, truth: Truth, scale: np.ndarray, lpips: LpipsBySuffix) -> dict[str, float]:
    """Compare on white outside the true mask, PSNR at the power 1/2.2 (TensoIR)."""
    assert truth.albedo is not None
    inside = (truth.alpha > 0)[..., None]
    albedo, true = _on_white(prediction.layer("albedo"), prediction.buffers.alpha), np.clip(_on_white(truth.albedo, truth.alpha), 0, 1)
    scaled, plain = (np.where(inside, np.clip(one, 0, 1), 1.0) for one in (albedo * scale, albedo))
    row = {
        f"albedo_psnr{name}": metrics.psnr(one ** (1 / GAMMA), true ** (1 / GAMMA)) for name, one in (("", scaled), ("_unscaled", plain))
    }
    return row | _structure(scaled, true, lpips)


def _masked_row(prediction: Prediction, truth: Truth, scale: np.ndarray, lpips: LpipsBySuffix) -> dict[str, float]:
    """Compare linear albedo inside the eroded true mask (Stanford-ORB)."""
    assert truth.albedo is not None
    inside = metrics.eroded(truth.alpha > 0.5)
    albedo, true = (np.clip(one, 0, 1) * inside[..., None] for one in (prediction.layer("albedo") * scale, truth.albedo))
    row = {"albedo_psnr": floored_psnr(albedo, true, inside), "albedo_ssim": metrics.ssim(albedo, true, 3)}
    return row | {f"albedo_lpips{suffix}": distance(encode_srgb(albedo), encode_srgb(true)) for suffix, distance in lpips.items()}


def _structure(albedo: np.ndarray, true: np.ndarray, lpips: LpipsBySuffix) -> dict[str, float]:
    """Return SSIM and LPIPS of two albedo images (H, W, 3)."""
    albedo, true = np.clip(albedo, 0, 1), np.clip(true, 0, 1)
    row = {"albedo_ssim": metrics.ssim(albedo, true)}
    return row | {f"albedo_lpips{suffix}": distance(albedo, true) for suffix, distance in lpips.items()}
