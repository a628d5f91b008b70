# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposure gains of a capture: by EXIF, corrected by the colours of sparse points where these contradict it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..datasets.exposure import estimate_log_gains, point_colours, shrunk
from ..scene.dataset import View
from .sparse_model import SparseModel


def exposure_gains(model: SparseModel, views: Sequence[View]) -> np.ndarray:
    """Return the linear gains (V, 3) of the registered photographs, of geometric mean 1.

    Args:
        model: sparse model, whose tracks tell which photographs show a point; without tracks, every photograph whose image it falls into.
        views: V undistorted images of `model.posed`, in the model's frame.
    """
    points = model.points
    if points is None:
        return np.ones((len(views), 3))
    seen = None
    if len(model.track_point):
        seen = np.zeros((len(views), len(model.position)), bool)
        seen[model.track_photograph, model.track_point] = True
    return np.exp(shrunk(estimate_log_gains(point_colours(views, points, seen)), stated_log_gains(model)))


def stated_log_gains(model: SparseModel) -> np.ndarray | None:
    """Return the log gains (V,) of mean 0 by EXIF; None unless all photographs state exposure time, ISO and f-number."""
    exposures = [posed.photograph.exposure for posed in model.posed]
    if any(one is None for one in exposures):
        return None
    logs = np.log(np.array(exposures, np.float64))
    return logs - logs.mean()
