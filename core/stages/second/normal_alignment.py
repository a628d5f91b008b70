# SPDX-License-Identifier: GPL-3.0-or-later
"""Disks turned towards the fused surface: it averages what single surfels scatter about."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from ...scene.gaussians import Gaussians
from ...scene.surface import Surface
from .gaussian_materials import surface_normals

FARTHEST = math.cos(math.radians(30))  # what differs by more is an edge, or on another side


def turned(gaussians: Gaussians, surface: Surface, share: float) -> Gaussians:
    """The surfels with normals that are `share` (0..1) the surface's and the rest their own."""
    own = gaussians.normals()
    other = torch.from_numpy(surface_normals(surface, np.ascontiguousarray(gaussians.position.T.cpu().numpy()))).to(own.device).T
    cosine = (own * other).sum(0)
    other = torch.where(cosine < 0, -other, other)
    mixed = torch.nn.functional.normalize((1 - share) * own + share * other, dim=0)
    goal = torch.where(cosine.abs() > FARTHEST, mixed, own)
    return replace(gaussians, quaternion=product(shortest_turn(own, goal), gaussians.quaternion))


def shortest_turn(source: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
    """(4, N) unit quaternions that turn unit vectors (3, N) to others less than 180 degrees away."""
    axis = torch.linalg.cross(source, goal, dim=0)
    return torch.nn.functional.normalize(torch.cat([1 + (source * goal).sum(0, keepdim=True), axis]), dim=0)


def product(left: torch.Tensor, right: torch.Tensor) -> torch.Tensor:
    """(4, N) Hamilton product w x y z: first `right`, then `left`."""
    (a, b, c, d), (w, x, y, z) = left, right
    real, i = a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y
    return torch.stack([real, i, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w])
