# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo against the true one. Its brightness can't be told from the light's, so all protocols scale it; they differ in how."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..io.srgb import encode_srgb
from . import metrics
from .ground_truth import Truth
from .image_metrics import Metrics, floored_psnr
from .prediction import Prediction
from .protocols import Protocol

GAMMA = 2.2
Sample = tuple[np.ndarray, np.ndarray]  # pixels (N, 3) linear: estimated, true


def scale_sample(prediction: Prediction, truth: Truth, how: Protocol) -> Sample | None:
    """The pixels of a view that have a say in the scale; None where its true albedo is not known."""
    if truth.albedo is None:
        return None
    albedo, true = prediction.layer("albedo"), truth.albedo
    if how.albedo_white:
        albedo, true = _on_white(albedo, prediction.buffers.alpha), _on_white(true, truth.alpha)
    mask = _scale_mask(truth, how)
    return albedo[mask], true[mask]


def scale_of(samples: Sequence[Sample | None], how: Protocol) -> np.ndarray | None:
    """(3,) factor of the albedo in all views, from the samples of all; None where none is known or each view has its own."""
    chosen = list(samples)
    if how.scale_views is not None and len(chosen) > how.scale_views:
        chosen = [chosen[i * (len(chosen) // how.scale_views)] for i in range(how.scale_views)]
    known = [sample for sample in chosen if sample is not None]
    return None if how.scale_each_view or not known else _scale(known, how)


def albedo_row(prediction: Prediction, truth: Truth, scale: np.ndarray | None, how: Protocol, lpips: Metrics) -> dict[str, float]:
    """Figures of one view, with the scale of all views; nothing where its true albedo is not known."""
    sample = scale_sample(prediction, truth, how)
    if sample is None or truth.albedo is None:
        return {}
    scale = _scale([sample], how) if scale is None else scale
    if how.radiance:
        return _masked_row(prediction, truth, scale, lpips)
    if how.albedo_white:
        return _white_row(prediction, truth, scale, lpips)
    alpha = truth.alpha[..., None]
    albedo, true = prediction.layer("albedo") * alpha, truth.albedo * alpha
    row = {"albedo_psnr": metrics.psnr(albedo * scale, true), "albedo_psnr_unscaled": metrics.psnr(albedo, true)}
    return row | _structure(albedo * scale, true, lpips)


def _scale(samples: Sequence[Sample], how: Protocol) -> np.ndarray:
    everywhere = [np.ones(len(ours), bool) for ours, _ in samples]
    return metrics.albedo_scale([ours for ours, _ in samples], [true for _, true in samples], everywhere, how.scale)


def _scale_mask(truth: Truth, how: Protocol) -> np.ndarray:
    assert truth.albedo is not None
    if how.scale_pixels == "covered":
        return truth.alpha > 0.5
    if how.scale_pixels == "eroded":
        return metrics.eroded(truth.alpha > 0.5)
    return (truth.alpha > 0) & ((truth.albedo > 0).all(-1) if how.scale_pixels == "lit" else True)


def _on_white(albedo: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return albedo * alpha[..., None] + 1 - alpha[..., None]


def _white_row(prediction: Prediction, truth: Truth, scale: np.ndarray, lpips: Metrics) -> dict[str, float]:
    assert truth.albedo is not None
    inside = (truth.alpha > 0)[..., None]
    albedo, true = _on_white(prediction.layer("albedo"), prediction.buffers.alpha), np.clip(_on_white(truth.albedo, truth.alpha), 0, 1)
    scaled, plain = (np.where(inside, np.clip(one, 0, 1), 1.0) for one in (albedo * scale, albedo))
    row = {
        f"albedo_psnr{name}": metrics.psnr(one ** (1 / GAMMA), true ** (1 / GAMMA)) for name, one in (("", scaled), ("_unscaled", plain))
    }
    return row | _structure(scaled, true, lpips)


def _masked_row(prediction: Prediction, truth: Truth, scale: np.ndarray, lpips: Metrics) -> dict[str, float]:
    assert truth.albedo is not None
    inside = metrics.eroded(truth.alpha > 0.5)
    albedo, true = (np.clip(one, 0, 1) * inside[..., None] for one in (prediction.layer("albedo") * scale, truth.albedo))
    row = {"albedo_psnr": floored_psnr(albedo, true, inside), "albedo_ssim": metrics.ssim(albedo, true, 3)}
    return row | {f"albedo_lpips{suffix}": distance(encode_srgb(albedo), encode_srgb(true)) for suffix, distance in lpips.items()}


def _structure(albedo: np.ndarray, true: np.ndarray, lpips: Metrics) -> dict[str, float]:
    albedo, true = np.clip(albedo, 0, 1), np.clip(true, 0, 1)
    row = {"albedo_ssim": metrics.ssim(albedo, true)}
    return row | {f"albedo_lpips{suffix}": distance(albedo, true) for suffix, distance in lpips.items()}
