# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposure and white balance of photographs: one linear gain per colour and photograph, and their removal from the pixels.

A camera with automatic exposure changes both from photograph to photograph. The gains make sparse points have the same colour in all
photographs that see them. What glossy points show depends on the direction: such points count little, and deviations of the size that
remains are taken for noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..io.srgb import decode_srgb, encode_srgb
from ..scene.dataset import PointCloud, View, light_rotations
from ..settings.schema import Choice

POINTS = 8000  # at most, with which gains are estimated
FEWEST_VIEWS = 3  # photographs that must show a point
FEWEST_POINTS = 20  # points in a photograph from which its gain is estimated
ROUNDS = 15  # alternations between the points' colours and the gains
DARKEST, BRIGHTEST = 0.05, 0.97  # encoded colours between which a pixel counts
STEADY = 0.02  # a point's standard deviation of log colour, below which all points count alike
OUTLIER = 0.1  # difference of log colour at which an observation counts half
OPAQUE = 0.9  # alpha from which a pixel belongs to the object
# Standard deviation of log gains and of log colour ratios that gloss alone causes (measured against ground truth).
BRIGHTNESS_NOISE, COLOUR_NOISE = 0.1, 0.07
EXPLAINED = 0.9  # disagreement about points with gains over that without, below which the gains are real
SMALLEST = 0.01  # standard deviation of log gains from which the photographs are changed


def even_exposures(views: Sequence[View], points: PointCloud | None, choice: Choice, warnings: list[str]) -> list[View]:
    """Return the photographs divided by their gains: those that the dataset states for all of them, or else estimates.

    Args:
        views: photographs.
        points: sparse points of the scene, or None.
        choice: "off": leave the photographs as they are; "auto": divide by estimated gains only where points that the estimate did not use
            agree better with them, which they do not on mirrors; "on": in any case.
        warnings: a line is appended where photographs were changed.
    """
    if choice == "off" or len(views) < FEWEST_VIEWS:
        return list(views)
    known = [view.gain for view in views if view.gain is not None]
    if len(known) == len(views):
        gains = np.stack(known)
    elif choice != "on" and light_rotations(views) is not None:  # shading that changes with the turns would be taken for gains
        return list(views)
    elif points is not None:
        logs = point_colours(views, points)
        if choice != "on" and unexplained(logs) > EXPLAINED:
            return list(views)
        gains = np.exp(shrunk(estimate_log_gains(logs)))
    else:
        return list(views)
    if np.log(gains).std(0).max() < SMALLEST:
        return list(views)
    low, high = gains.mean(1).min(), gains.mean(1).max()
    warnings.append(f"the photographs' exposure differs by factors of {low:.2f} to {high:.2f}; evened out (data.exposure)")
    return [replace(view, colour=_divided(view.colour, gain)) for view, gain in zip(views, gains, strict=True)]


def point_colours(views: Sequence[View], points: PointCloud, seen: np.ndarray | None = None) -> np.ndarray:
    """Return the log linear colours (V, P, 3) that photographs show of points; NaN where none is seen, or one too dark or too bright.

    Args:
        views: V photographs.
        points: sparse points; an even selection of at most POINTS is used.
        seen: (V, all points) bool, True where the photograph is known to show the point; None: by projection alone.
    """
    every = max(1, -(-len(points.position) // POINTS))
    position = points.position[::every].astype(np.float64)
    visible = None if seen is None else seen[:, ::every]
    return np.stack([_log_colours(view, position, None if visible is None else visible[i]) for i, view in enumerate(views)])


def _log_colours(view: View, points: np.ndarray, visible: np.ndarray | None) -> np.ndarray:
    """Return the log linear colours (P, 3) of a photograph at points (P, 3), NaN as in `point_colours`."""
    pixel, depth = view.camera.project(points)
    inside = view.camera.in_image(pixel, depth)
    found = np.flatnonzero(inside if visible is None else inside & visible)
    column, row = pixel[found].astype(int).T
    colour = view.colour[row, column]
    usable = ((colour > DARKEST) & (colour < BRIGHTEST)).all(1)
    if view.alpha is not None:
        usable &= view.alpha[row, column] > OPAQUE
    logs = np.full((len(points), 3), np.nan)
    logs[found[usable]] = np.log(decode_srgb(colour[usable].astype(np.float64)))
    return logs


def estimate_log_gains(logs: np.ndarray) -> np.ndarray:
    """Estimate log gains (V, 3) of mean 0 by alternating, robustly weighted least squares.

    Points count by the inverse variance of their colour over the photographs, so that matt points decide.

    Args:
        logs: (V, P, 3) log colours of points, see `point_colours`.
    """
    seen = np.isfinite(logs[..., 0])
    seen &= seen.sum(0) >= FEWEST_VIEWS
    enough = seen.sum(1) >= FEWEST_POINTS
    seen[~enough] = False
    values, weight, gains = np.where(seen[..., None], logs, 0), seen.astype(np.float64), np.zeros((len(logs), 3))
    for _ in range(ROUNDS):
        total = np.maximum(weight.sum(0), 1e-12)
        mean = (weight[..., None] * (values - gains[:, None])).sum(0) / total[:, None]
        square = np.where(seen[..., None], values - gains[:, None] - mean, 0) ** 2
        variance = (weight[..., None] * square).sum((0, 2)) / total / 3
        weight = seen / (variance + STEADY**2) / (1 + square.mean(2) / OUTLIER**2)
        gains = (weight[..., None] * (values - mean)).sum(1) / np.maximum(weight.sum(1), 1e-12)[:, None]
        gains[~enough] = gains[enough].mean(0) if enough.any() else 0
        gains -= gains.mean(0)
    return gains


def shrunk(log_gains: np.ndarray, expected: np.ndarray | None = None) -> np.ndarray:
    """Return log gains (V, 3) of mean 0 with the part removed that may be noise: empirical Bayes shrinkage of their deviations.

    Brightness is shrunk apart from the ratios of the colours, whose noise is smaller.

    Args:
        log_gains: (V, 3) estimates.
        expected: (V,) log gains by the photographs' metadata; None: all alike.
    """
    expected = np.zeros(len(log_gains)) if expected is None else expected - expected.mean()
    brightness = log_gains.mean(1)
    ratios = log_gains - brightness[:, None]
    brightness = expected + _shrunk(brightness - brightness.mean() - expected, BRIGHTNESS_NOISE)
    return brightness[:, None] + np.stack([_shrunk(one - one.mean(), COLOUR_NOISE) for one in ratios.T], 1)


def unexplained(logs: np.ndarray) -> float:
    """Return the disagreement about points with gains over that without; each half of the points tests the gains of the other.

    Args:
        logs: (V, P, 3) log colours of points, see `point_colours`.
    """
    ratios = []
    for half in (0, 1):
        gains, others = shrunk(estimate_log_gains(logs[:, half::2])), logs[:, 1 - half :: 2]
        ratios.append(_disagreement(others - gains[:, None]) / max(_disagreement(others), 1e-9))
    return float(np.mean(ratios))


def _disagreement(logs: np.ndarray) -> float:
    """Return the median absolute difference of log colours (V, P, 3) from each point's median; 0 where nothing is known."""
    logs = logs[:, np.isfinite(logs[..., 0]).sum(0) >= FEWEST_VIEWS]
    difference = np.abs(logs - np.nanmedian(logs, 0)) if logs.size else np.zeros(0)
    return float(np.nanmedian(difference)) if difference.size else 0.0


def _shrunk(deviation: np.ndarray, noise: float) -> np.ndarray:
    """Return deviations (V,) times the share of their variance that noise does not explain."""
    return deviation * max(0.0, 1 - noise**2 / max(float(deviation.var()), 1e-12))


def _divided(colour: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """Return sRGB-encoded colours (H, W, 3) after division of the linear ones by a gain (3,)."""
    return encode_srgb(decode_srgb(colour) / gain).astype(np.float32)
