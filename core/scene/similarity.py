# SPDX-License-Identifier: GPL-3.0-or-later
"""Similarities of space: a rotation, a scale and a translation as one matrix (4, 4)."""

from __future__ import annotations

import numpy as np


def moved_points(points: np.ndarray, similarity: np.ndarray) -> np.ndarray:
    """Return points (P, 3) after a similarity (4, 4)."""
    return points @ similarity[:3, :3].T + similarity[:3, 3]


def scale_of(similarity: np.ndarray) -> float:
    """Return the factor by which a similarity (4, 4) scales lengths."""
    return float(np.cbrt(np.linalg.det(similarity[:3, :3])))
