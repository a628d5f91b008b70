# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearest neighbours among points of the world, by a k-d tree."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import KDTree

from ...machine.thread_pool import thread_count


def nearest_neighbours(points: torch.Tensor, queries: torch.Tensor, count: int) -> torch.Tensor:
    """Find the points that are nearest to each query; a point that is its own query is its first neighbour.

    Args:
        points: (P, 3) world, P > 0, on any device.
        queries: (N, 3) world, on any device.
        count: most neighbours of a query, > 0.

    Returns:
        (N, min(count, P)) int64 indices of points, the nearest first, on the device of the points.
    """
    places = [one.detach().cpu().numpy() for one in (points, queries)]
    _, nearest = KDTree(places[0]).query(places[1], k=min(count, len(points)), workers=thread_count())
    return torch.from_numpy(np.asarray(nearest).reshape(len(queries), -1)).to(points.device)
