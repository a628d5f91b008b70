# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps the Gaussians a thin layer.

Where disks scatter about the surface, a silhouette is drawn by the outermost ones, so the masks push the layer's middle inside
the object (by half a pixel on measured scenes). Pulling each disk to the planes of its neighbours takes that bias away.
"""

from __future__ import annotations

import torch
from scipy.spatial import KDTree

from ..scene.gaussians import Gaussians

NEIGHBOURS = 8
ALIKE = 0.7  # cosine between normals from which two disks lie on the same sheet


def layer_offset(position: torch.Tensor, normal: torch.Tensor, solid: torch.Tensor) -> torch.Tensor:
    """(N,) height of each disk over its neighbours, along its normal.

    The mean of (n_i + n_j) . (p_i - p_j) / 2 over neighbours on the same sheet: zero on any sphere, so curvature is not flattened.

    Args:
        position, normal: (N, 3); solid: (N,) indices of disks that count as neighbours.
    """
    tree = KDTree(position[solid].numpy())
    j = solid[torch.from_numpy(tree.query(position.numpy(), k=NEIGHBOURS + 1, workers=-1)[1])]
    alike = (normal[:, None] * normal[j]).sum(-1)
    weight = (alike > ALIKE).float() * (j != torch.arange(len(position))[:, None])
    height = 0.5 * ((normal[:, None] + normal[j]) * (position[:, None] - position[j])).sum(-1)
    return (weight * height).sum(1) / weight.sum(1).clamp_min(1)


def thin(gaussians: Gaussians, share: float) -> None:
    """Move every disk by `share` of its height over its neighbours back along its normal, in place."""
    with torch.no_grad():
        solid = torch.nonzero(gaussians.opacity > 0)[:, 0]  # more than half opaque
        if len(solid) <= NEIGHBOURS:
            return
        normal = gaussians.normals()
        offset = layer_offset(gaussians.position.T.contiguous(), normal.T.contiguous(), solid)
        gaussians.position -= share * offset * normal
