# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal alignment: surfels are turned towards the fused surface, which averages the noise of single surfels."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from ....scene.gaussians import Gaussians
from ....scene.surface import Surface
from ....scene.unit_vectors import unit_vectors
from ..solver.gaussian_materials import surface_normals

MIN_COSINE = math.cos(math.radians(30))  # surfels at a larger angle lie on an edge or on another side and stay


def align_normals(gaussians: Gaussians, surface: Surface, fraction: float) -> Gaussians:
    """Turn the surfels so that their normals are a mix of the surface's and their own.

    Args:
        gaussians: the surfels.
        surface: fused from their depth.
        fraction: weight of the surface's normal in the mix, 0..1.
    """
    own = gaussians.normals()
    other = torch.from_numpy(surface_normals(surface, np.ascontiguousarray(gaussians.position.T.cpu().numpy()))).to(own.device).T
    cosine = (own * other).sum(0)
    other = torch.where(cosine < 0, -other, other)
    mixed = unit_vectors((1 - fraction) * own + fraction * other)
    goal = torch.where(cosine.abs() > MIN_COSINE, mixed, own)
    return replace(gaussians, quaternion=product(shortest_turn(own, goal), gaussians.quaternion))


def follow_normals(gaussians: Gaussians, before: Surface, after: Surface, fraction: float) -> Gaussians:
    """Turn the surfels by as much as the surface's normals turned, which keeps what they know of silhouettes.

    Args:
        gaussians: the surfels.
        before: surface whose normals did not explain the shading.
        after: surface with the same vertices and the new normals.
        fraction: part of the turn that the surfels follow, 0..1.
    """
    own, position = gaussians.normals(), np.ascontiguousarray(gaussians.position.T.cpu().numpy())
    old, new = (torch.from_numpy(surface_normals(surface, position)).to(own.device).T for surface in (before, after))
    cosine = (own * old).sum(0)
    change = torch.where(cosine < 0, old - new, new - old)
    goal = torch.where(cosine.abs() > MIN_COSINE, unit_vectors(own + fraction * change), own)
    return replace(gaussians, quaternion=product(shortest_turn(own, goal), gaussians.quaternion))


def shortest_turn(source: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
    """Compute the shortest rotations between unit vectors.

    Args:
        source: (3, N) unit vectors.
        goal: (3, N) unit vectors less than 180 degrees away.

    Returns:
        (4, N) unit quaternions w x y z.
    """
    axis = torch.linalg.cross(source, goal, dim=0)
    return unit_vectors(torch.cat([1 + (source * goal).sum(0, keepdim=True), axis]))


def product(left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    """Multiply quaternions w x y z (Hamilton product): the rotation `right` followed by `left`.

    Args:
        left: (4, N).
        right: (4, N).

    Returns:
        (4, N).
    """
    (a, b, c, d), (w, x, y, z) = left, right
    real, i = a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y
    return torch.stack([real, i, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w])
