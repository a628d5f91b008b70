# SPDX-License-Identifier: GPL-3.0-or-later
"""How far what a reconstruction shows of one view is from the truth, and the means over all views."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from . import metrics
from .albedo import Sample, albedo_row, scale_of, scale_sample
from .ground_truth import Truth
from .image_metrics import Metrics, image_figures
from .prediction import Prediction
from .protocols import PLAIN, Protocol

UP = np.array([0.0, 0.0, 1.0])


class Fits:
    """What is fitted once for all views, gathered view by view."""

    def __init__(self, how: Protocol) -> None:
        self.how = how
        self._samples: list[Sample | None] = []
        self._product, self._square = 0.0, 0.0

    def gather(self, prediction: Prediction, truth: Truth) -> None:
        """Take one more view into account."""
        self._samples.append(scale_sample(prediction, truth, self.how))
        if self.how.scale_free and truth.depth is not None:
            inside = metrics.eroded(truth.alpha > 0.5)
            ours, true = prediction.layer("depth")[inside].astype(np.float64), truth.depth[inside].astype(np.float64)
            self._product, self._square = self._product + float((ours * true).sum()), self._square + float((ours * ours).sum())

    @cached_property
    def albedo(self) -> np.ndarray | None:
        """(3,) factors of the albedo; None where none is known, or each view has its own."""
        return scale_of(self._samples, self.how)

    @property
    def depth(self) -> float:
        """Factor of the depth."""
        return self._product / max(self._square, 1e-12)


def view_figures(prediction: Prediction, truth: Truth, how: Protocol = PLAIN, lpips: Metrics | None = None) -> dict[str, float]:
    """Every figure of one view that needs no other view; names as in the report."""
    figures, own = {}, {} if prediction.shaded is None else {"nvs": prediction.shaded, "radiance": prediction.buffers.image}
    for label, rgba in own.items():
        figures |= _labelled(label, image_figures(label, rgba, truth.image, truth, how, lpips or {}))
    return figures | relit_figures(prediction, truth, how, lpips) | _labelled("", _layer_figures(prediction, truth, how))


def relit_figures(prediction: Prediction, truth: Truth, how: Protocol = PLAIN, lpips: Metrics | None = None) -> dict[str, float]:
    """Those of the images under other lights."""
    figures = {}
    for name in prediction.relit.keys() & truth.relit.keys():
        figures |= _labelled(
            f"relight_{name}", image_figures("relight", prediction.relit[name], truth.relit[name], truth, how, lpips or {})
        )
    return figures


def _labelled(label: str, figures: dict[str, float]) -> dict[str, float]:
    return {f"{label}_{name}" if label else name: float(value) for name, value in figures.items()}


def _layer_figures(prediction: Prediction, truth: Truth, how: Protocol) -> dict[str, float]:
    inside = truth.object
    if not inside.any():
        return {}
    figures = _normal_figures(prediction, truth, how)
    for name in ("depth", "roughness", "metallic"):
        true = getattr(truth, name)
        if true is not None:
            figures[f"{name}_mae"] = np.abs(prediction.layer(name) - true)[inside].mean()
    return figures


def _normal_figures(prediction: Prediction, truth: Truth, how: Protocol) -> dict[str, float]:
    if truth.normal is None:
        return {}
    ours, true = prediction.layer("normal"), truth.normal
    angle = metrics.normal_angles(ours, true)
    figures = {"normal_mae": angle[truth.object].mean()}
    if how.blended_normals:
        faded = [_faded(ours, prediction.buffers.alpha), _faded(true, truth.alpha)]
        figures["normal_mae_full"] = metrics.normal_angles(*faded).mean()
    else:
        there = np.linalg.norm(true, axis=-1) > 0.5 if truth.depth is None else truth.depth > 0
        figures["normal_mae_full"] = np.where(there, angle, 0).mean()
    if how.scale_free and (mask := metrics.eroded(truth.alpha > 0.5)).any():
        figures["normal_cosine"] = metrics.cosine_distance(ours, true, mask)
    return figures


def _faded(normal: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Normals (H, W, 3) that fade to +Z with alpha (H, W)."""
    return normal * alpha[..., None] + UP * (1 - alpha[..., None])


def fitted_figures(
    prediction: Prediction, truth: Truth, fits: Fits, how: Protocol, unit: float = 1.0, lpips: Metrics | None = None
) -> dict[str, float]:
    """Figures of one view after what was fitted to all views; `unit`: lengths of ours that are one of the dataset's."""
    row = albedo_row(prediction, truth, fits.albedo, how, lpips or {})
    if how.scale_free and truth.depth is not None:
        inside = metrics.eroded(truth.alpha > 0.5)
        error = np.where(inside, fits.depth * prediction.layer("depth").astype(np.float64) - truth.depth, 0) / unit
        row["depth_si_mse"] = float(np.square(error).mean())
    return row


def albedo_figures(predictions: Sequence[Prediction], truths: Sequence[Truth]) -> tuple[list[dict[str, float]], np.ndarray | None]:
    """Albedo figures of each view after the one scale of all views, and that scale (3,); nothing where no view has a true albedo."""
    scale = scale_of([scale_sample(p, t, PLAIN) for p, t in zip(predictions, truths, strict=True)], PLAIN)
    return [albedo_row(p, t, scale, PLAIN, {}) for p, t in zip(predictions, truths, strict=True)], scale


def averages(rows: Sequence[dict[str, float]], relights: Sequence[str], how: Protocol = PLAIN) -> dict[str, float]:
    """The mean of each figure over the views that have it, and of the relit ones over the lights."""
    names = sorted({name for row in rows for name in row})
    mean = {name: float(np.mean([row[name] for row in rows if name in row])) for name in names}
    if how.albedo_white:
        mean |= {name: _pooled([row[name] for row in rows if name in row]) for name in names if name.startswith("albedo_psnr")}
    of_lights: dict[str, list[float]] = {}
    for light in relights:
        for name in names:
            what = name.removeprefix(f"relight_{light}_")
            if what != name and what.partition("_")[0] in ("psnr", "ssim", "lpips"):
                of_lights.setdefault(what, []).append(mean[name])
    return mean | {f"relight_{what}": float(np.mean(values)) for what, values in of_lights.items()}


def _pooled(psnrs: Sequence[float]) -> float:
    """The PSNR of the mean square error of all views."""
    return float(-10 * np.log10(np.mean(10 ** (-np.array(psnrs) / 10))))
