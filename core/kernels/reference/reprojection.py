# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of the reprojection error: the points of all pixels, projected into each source."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import map_coordinates

from ...scene.camera import Camera

Posed = tuple[Camera, np.ndarray, np.ndarray]  # a view: camera, planar depth (H, W), 0 for none, and encoded colour (H, W, 3)


def source_difference(view: Posed, source: Posed, relative: float) -> np.ndarray:
    """Return the mean absolute difference of a source's colours from a view's, (H, W); NaN where the source does not see the point.

    Args:
        view: its depth places the points.
        source: sees a point whose depth in it is that of the pixel that the point falls on.
        relative: difference of these depths, as a fraction, up to which it does.
    """
    (camera, depth, colour), (other, other_depth, other_colour) = view, source
    points = camera.centre + depth[..., None].astype(np.float64) * camera.rays().astype(np.float64)
    pixel, far = other.project(points.reshape(-1, 3))
    column, row = np.floor(pixel).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < other.width) & (row < other.height) & (depth.ravel() > 0) & (far > 0)
    seen = other_depth[np.clip(row, 0, other.height - 1), np.clip(column, 0, other.width - 1)]
    inside &= (seen > 0) & (np.abs(seen - far) <= relative * far)
    layers = [map_coordinates(other_colour[..., c].astype(np.float64), pixel.T[::-1] - 0.5, order=1, mode="nearest") for c in range(3)]
    difference = np.abs(np.stack(layers, -1) - colour.reshape(-1, 3)).mean(-1)
    return np.where(inside, difference, np.nan).reshape(depth.shape)


def reprojection_error_reference(view: Posed, sources: Sequence[Posed], relative: float) -> np.ndarray:
    """Return the mean of `source_difference` over the sources that see the pixel's point, (H, W); NaN where none does.

    Args:
        view: that is compared.
        sources: at least one.
        relative: see `source_difference`.
    """
    differences = np.stack([source_difference(view, source, relative) for source in sources])
    seen = np.isfinite(differences).sum(0)
    return np.where(seen > 0, np.nansum(differences, 0) / np.maximum(seen, 1), np.nan)
