# SPDX-License-Identifier: GPL-3.0-or-later
"""Metrics of one view against its ground truth, and their means over all views."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ..rendering.gbuffer import render_gbuffer
from ..scene.dataset import View
from ..scene.reconstruction import Reconstruction
from . import metrics
from .albedo import Sample, albedo_row, scale_of, scale_sample
from .ground_truth import Truth
from .image_metrics import LpipsBySuffix, image_metrics
from .prediction import Prediction
from .protocols import PLAIN, Protocol

UP = np.array([0.0, 0.0, 1.0])
CALLED_METAL = 0.5  # metallic above which a pixel counts as metal
NO_METAL = 0.5 / 255  # true metallic up to which a pixel is certainly none; 8-bit maps have no value in between


class Fits:
    """Scales of albedo and depth that are fitted once for all views, from samples gathered view by view."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self._samples: list[Sample | None] = []
        self._product, self._square = 0.0, 0.0

    def gather(self, prediction: Prediction, truth: Truth) -> None:
        """Add one more view to the fits.

        Args:
            prediction: of the view.
            truth: of the view.
        """
        self._samples.append(scale_sample(prediction, truth, self.protocol))
        if self.protocol.scale_free and truth.depth is not None:
            inside = metrics.eroded(truth.alpha > 0.5)
            ours, true = prediction.layer("depth")[inside].astype(np.float64), truth.depth[inside].astype(np.float64)
            self._product, self._square = self._product + float((ours * true).sum()), self._square + float((ours * ours).sum())

    @cached_property
    def albedo(self) -> np.ndarray | None:
        """(3,) factors of the albedo; None where no true albedo is known, or each view has its own."""
        return scale_of(self._samples, self.protocol)

    @property
    def depth(self) -> float:
        """Least-squares factor of the depth."""
        return self._product / max(self._square, 1e-12)


def view_metrics(prediction: Prediction, truth: Truth, protocol: Protocol = PLAIN, lpips: LpipsBySuffix | None = None) -> dict[str, float]:
    """Return every metric of one view that needs no other view, by its name in the report.

    Args:
        prediction: of the view.
        truth: of the view.
        protocol: of the comparison.
        lpips: perceptual distances.
    """
    values, own = {}, {} if prediction.shaded is None else {"nvs": prediction.shaded, "radiance": prediction.buffers.image}
    for label, rgba in own.items():
        values |= _labelled(label, image_metrics(label, rgba, truth.image, truth, protocol, lpips or {}))
    return values | relit_metrics(prediction, truth, protocol, lpips) | _labelled("", _layer_metrics(prediction, truth, protocol))


def relit_metrics(prediction: Prediction, truth: Truth, protocol: Protocol = PLAIN, lpips: LpipsBySuffix | None = None) -> dict[str, float]:
    """Return the metrics of a view's images under other lights.

    Args:
        prediction: of the view.
        truth: of the view.
        protocol: of the comparison.
        lpips: perceptual distances.
    """
    values = {}
    for name in prediction.relit.keys() & truth.relit.keys():
        values |= _labelled(
            f"relight_{name}", image_metrics("relight", prediction.relit[name], truth.relit[name], truth, protocol, lpips or {})
        )
    return values


def _labelled(label: str, values: dict[str, float]) -> dict[str, float]:
    return {f"{label}_{name}" if label else name: float(value) for name, value in values.items()}


def _layer_metrics(prediction: Prediction, truth: Truth, protocol: Protocol) -> dict[str, float]:
    """Compare normal, depth, roughness and metallic over the object."""
    inside = truth.object
    if not inside.any():
        return {}
    values = _normal_metrics(prediction.layer("normal"), prediction.buffers.alpha, truth, protocol)
    for name in ("depth", "roughness", "metallic"):
        true = getattr(truth, name)
        if true is not None:
            difference = (prediction.layer(name) - true)[inside]
            values[f"{name}_mae"] = np.abs(difference).mean()
            values |= {"roughness_mse": np.square(difference).mean()} if name == "roughness" else {}
    if truth.metallic is not None:
        wrong = (prediction.layer("metallic") > CALLED_METAL) & (truth.metallic <= NO_METAL)
        values["metallic_false_fraction"] = wrong[inside].mean()
    return values


def mesh_metrics(normal: np.ndarray, alpha: np.ndarray, truth: Truth, protocol: Protocol) -> dict[str, float]:
    """Return the metrics of the extracted mesh's normals in a view.

    Args:
        normal: (H, W, 3) unit, world, 0 where no mesh is.
        alpha: (H, W) 1 where the mesh is, else 0.
        truth: of the view.
        protocol: of the comparison.
    """
    return _labelled("mesh", _normal_metrics(normal, alpha, truth, protocol)) if truth.object.any() else {}


def _normal_metrics(ours: np.ndarray, alpha: np.ndarray, truth: Truth, protocol: Protocol) -> dict[str, float]:
    """Compare normals (H, W, 3) of opacity `alpha` (H, W)."""
    true = truth.normal
    if true is None:
        return {}
    angle = metrics.normal_angles(ours, true)
    values = {"normal_mae": angle[truth.object].mean()}
    if protocol.blended_normals:
        faded = [_faded(ours, alpha), _faded(true, truth.alpha)]
        values["normal_mae_full"] = metrics.normal_angles(*faded).mean()
    else:
        covered = np.linalg.norm(true, axis=-1) > 0.5 if truth.depth is None else truth.depth > 0
        values["normal_mae_full"] = np.where(covered, angle, 0).mean()
    if protocol.scale_free and (mask := metrics.eroded(truth.alpha > 0.5)).any():
        values["normal_cosine"] = metrics.cosine_distance(ours, true, mask)
    return values


def _faded(normal: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Blend normals (H, W, 3) with +Z by alpha (H, W)."""
    return normal * alpha[..., None] + UP * (1 - alpha[..., None])


def fitted_metrics(
    prediction: Prediction, truth: Truth, fits: Fits, protocol: Protocol, unit: float = 1.0, lpips: LpipsBySuffix | None = None
) -> dict[str, float]:
    """Return the metrics of one view that need the scales fitted to all views: albedo, and depth up to a factor.

    Args:
        prediction: of the view.
        truth: of the view.
        fits: scales of all views.
        protocol: of the comparison.
        unit: length in the run's world frame of one unit of the dataset.
        lpips: perceptual distances.
    """
    row = albedo_row(prediction, truth, fits.albedo, protocol, lpips or {})
    if protocol.scale_free and truth.depth is not None:
        inside = metrics.eroded(truth.alpha > 0.5)
        error = np.where(inside, fits.depth * prediction.layer("depth").astype(np.float64) - truth.depth, 0) / unit
        row["depth_si_mse"] = float(np.square(error).mean())
    return row


def albedo_metrics(predictions: Sequence[Prediction], truths: Sequence[Truth]) -> tuple[list[dict[str, float]], np.ndarray | None]:
    """Return the albedo metrics of each view by this program's own protocol, after one scale for all views.

    Args:
        predictions: of all views.
        truths: of the same views.

    Returns:
        A dictionary for each view, and the scale (3,); empty dictionaries and None where no view has a true albedo.
    """
    scale = scale_of([scale_sample(p, t, PLAIN) for p, t in zip(predictions, truths, strict=True)], PLAIN)
    return [albedo_row(p, t, scale, PLAIN, {}) for p, t in zip(predictions, truths, strict=True)], scale


def averages(rows: Sequence[dict[str, float]], relights: Sequence[str], protocol: Protocol = PLAIN) -> dict[str, float]:
    """Return the mean of each metric over the views that have it, and of relit images over the lights as well.

    Args:
        rows: metrics of each view.
        relights: names of the lights whose means "relight_psnr" and the like are taken over.
        protocol: whether the albedo's PSNR is pooled.
    """
    names = sorted({name for row in rows for name in row})
    mean = {name: float(np.mean([row[name] for row in rows if name in row])) for name in names}
    if protocol.albedo_white:
        mean |= {name: _pooled([row[name] for row in rows if name in row]) for name in names if name.startswith("albedo_psnr")}
    of_lights: dict[str, list[float]] = {}
    for light in relights:
        for name in names:
            metric = name.removeprefix(f"relight_{light}_")
            if metric != name and metric.partition("_")[0] in ("psnr", "ssim", "lpips"):
                of_lights.setdefault(metric, []).append(mean[name])
    return mean | {f"relight_{metric}": float(np.mean(values)) for metric, values in of_lights.items()}


def _pooled(psnrs: Sequence[float]) -> float:
    """Return the PSNR in dB of the mean square error of all views."""
    return float(-10 * np.log10(np.mean(10 ** (-np.array(psnrs) / 10))))


def radiance_psnr(reconstruction: Reconstruction, views: Sequence[View]) -> float:
    """Return the mean PSNR in dB of the Gaussians' own radiance against images, sRGB-encoded, on black by their own alpha.

    Args:
        reconstruction: Gaussians to rasterise.
        views: images (H, W, 3) with their cameras and, where they have one, alpha (H, W).
    """
    values = []
    for view in views:
        rgba = render_gbuffer(reconstruction, view.camera, view.light_rotation).image
        alpha = 1.0 if view.alpha is None else view.alpha[..., None]
        values.append(metrics.psnr(metrics.on_black(rgba), np.clip(view.colour, 0, 1) * alpha))
    return float(np.mean(values))
