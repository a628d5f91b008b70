# SPDX-License-Identifier: GPL-3.0-or-later
"""What a reconstruction shows of one view, and how far that is from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..scene.buffers import NOTHING, ViewBuffers
from . import metrics
from .truth import Truth


@dataclass(frozen=True, eq=False)
class Prediction:
    """One view of a reconstruction: its layers, and pictures (H, W, 4) linear premultiplied under its own and under other lights."""

    buffers: ViewBuffers
    shaded: np.ndarray
    relit: dict[str, np.ndarray] = field(default_factory=dict)

    def layer(self, name: str) -> np.ndarray:
        """A layer of the buffers, 0 where nothing is."""
        values, there = getattr(self.buffers, name), self.buffers.alpha > NOTHING
        return np.nan_to_num(np.where(there if values.ndim == 2 else there[..., None], values, 0))


def view_figures(prediction: Prediction, truth: Truth) -> dict[str, float]:
    """Every figure of one view that needs no other view; names as in the report."""
    inside = truth.object
    figures = _picture_figures("nvs", prediction.shaded, truth.picture, inside)
    figures |= _picture_figures("radiance", prediction.buffers.picture, truth.picture, inside)
    for name in truth.relit.keys() & prediction.relit.keys():
        figures |= _picture_figures(f"relight_{name}", prediction.relit[name], truth.relit[name], inside)
    if not inside.any():
        return figures
    if truth.normal is not None and truth.depth is not None:
        angle = metrics.normal_angles(prediction.layer("normal"), truth.normal)
        figures |= {"normal_mae": angle[inside].mean(), "normal_mae_full": np.where(truth.depth > 0, angle, 0).mean()}
    for name in ("depth", "roughness", "metallic"):
        true = getattr(truth, name)
        if true is not None:
            figures[f"{name}_mae"] = np.abs(prediction.layer(name) - true)[inside].mean()
    return {name: float(value) for name, value in figures.items()}


def _picture_figures(label: str, rgba: np.ndarray, truth: np.ndarray, inside: np.ndarray) -> dict[str, float]:
    picture = metrics.on_black(rgba)
    figures = {f"{label}_psnr": metrics.psnr(picture, truth), f"{label}_ssim": metrics.ssim(picture, truth)}
    return figures | ({f"{label}_psnr_object": metrics.psnr(picture, truth, inside)} if inside.any() else {})


def albedo_figures(predictions: Sequence[Prediction], truths: Sequence[Truth]) -> tuple[list[dict[str, float]], np.ndarray | None]:
    """Albedo figures of each view after the one scale of all views, and that scale (3,); nothing where no view has a true albedo."""
    known = [(p.layer("albedo"), t.albedo, t.alpha) for p, t in zip(predictions, truths, strict=True) if t.albedo is not None]
    if not known:
        return [{} for _ in truths], None
    scale = metrics.albedo_scale([a for a, _, _ in known], [t for _, t, _ in known], [alpha > 0.5 for _, _, alpha in known])
    rows = []
    for prediction, truth in zip(predictions, truths, strict=True):
        if truth.albedo is None:
            rows.append({})
            continue
        alpha = truth.alpha[..., None]
        albedo, true = prediction.layer("albedo") * alpha, truth.albedo * alpha
        scaled = albedo * scale
        rows.append(
            {
                "albedo_psnr": metrics.psnr(scaled, true),
                "albedo_ssim": metrics.ssim(np.clip(scaled, 0, 1), np.clip(true, 0, 1)),
                "albedo_psnr_unscaled": metrics.psnr(albedo, true),
            }
        )
    return rows, scale


def averages(rows: Sequence[dict[str, float]], relights: Sequence[str]) -> dict[str, float]:
    """The mean of each figure over the views that have it, and of the relit ones over the lights."""
    names = sorted({name for row in rows for name in row})
    mean = {name: float(np.mean([row[name] for row in rows if name in row])) for name in names}
    for what in ("psnr", "ssim", "psnr_object"):
        values = [mean[f"relight_{light}_{what}"] for light in relights if f"relight_{light}_{what}" in mean]
        if values:
            mean[f"relight_{what}"] = float(np.mean(values))
    return mean
