# SPDX-License-Identifier: GPL-3.0-or-later
"""Sparse points from PLY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plyfile import PlyData

from ..errors import InputError
from ..scene.dataset import PointCloud
from .parsed_dataset import FARTHEST


def read_points(path: Path) -> PointCloud:
    """Read the points of a PLY file in its own frame, grey if it has no colours.

    Raises:
        InputError: if the file is damaged.
    """
    try:
        vertex = PlyData.read(str(path))["vertex"]
        position = np.stack([vertex[c] for c in "xyz"], -1).astype(np.float32)
        names = {p.name for p in vertex.properties}
        colour = np.stack([vertex[c] for c in ("red", "green", "blue")], -1) if "red" in names else np.full(position.shape, 128, np.uint8)
    except Exception as error:  # plyfile raises many kinds for broken files
        raise InputError(path, f"not a readable PLY of points ({error})") from error
    if not (np.abs(position) < FARTHEST).all():
        raise InputError(path, "has points at infinity")
    return PointCloud(position, colour.astype(np.float32) / (255 if colour.dtype == np.uint8 else 1))
