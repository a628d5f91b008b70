# SPDX-License-Identifier: GPL-3.0-or-later
"""What the photographs say about single points of the surface: each point seen from many sides, side by side.

Differences between the views of one point are gloss, and gloss shows the light without knowing the albedo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...io.srgb import decode_srgb
from ...kernels.trace import Tree, transmittance
from ...scene.dataset import View
from ..common.training_view import SATURATED

FACING = 0.15  # cosine below which a view says more about the silhouette than about the point
FREE = 0.5  # transmittance towards the camera from which a point is seen
INSIDE = 0.99  # opacity of the mask around a point: no background in its colour


@dataclass(frozen=True, eq=False)
class MultiViewSamples:
    """P points and K views of them, those of a point side by side.

    Attributes:
        position, normal: (P, 3) float32, world; normals unit, outward.
        point: (K,) int64, ascending. view: (K, 3) unit, towards the camera.
        colour: (K, 3) linear radiance. saturated: (K, 3) bool, where that is only a lower bound.
    """

    position: torch.Tensor
    normal: torch.Tensor
    point: torch.Tensor
    view: torch.Tensor
    colour: torch.Tensor
    saturated: torch.Tensor

    @property
    def lengths(self) -> torch.Tensor:
        """(P,) views of each point."""
        return torch.bincount(self.point, minlength=len(self.position))

    def part(self, begin: int, end: int) -> MultiViewSamples:
        """Points begin..end and their views."""
        first, last = (int(k) for k in torch.searchsorted(self.point, torch.tensor([begin, end], device=self.point.device)))
        views = slice(first, last)
        point = self.point[views] - begin
        return MultiViewSamples(
            self.position[begin:end], self.normal[begin:end], point, self.view[views], self.colour[views], self.saturated[views]
        )

    def sums(self, values: torch.Tensor) -> torch.Tensor:
        """(K, ...) summed over the views of each point: (P, ...), always in the same order."""
        return torch.segment_reduce(values, "sum", lengths=self.lengths, axis=0, unsafe=True)


def observe(
    position: np.ndarray,
    normal: np.ndarray,
    views: Sequence[View],
    tree: Tree,
    offset: float,
    random: np.random.Generator,
    most: int,
    least: int = 3,
    device: torch.device | str = "cpu",
) -> tuple[MultiViewSamples, torch.Tensor]:
    """Look points (P, 3) up in the photographs that see them.

    Args:
        position, normal: (P, 3) float32, of the surface. views: the photographs. tree: what may stand in the way.
        offset: world units along the normal that clear the surface's own surfels.
        most: views kept of each point, chosen by `random`. least: points seen by fewer are left out.
        device: where the tree is, and where the result comes to be.

    Returns:
        The observations and which of the points they are of.
    """
    device = torch.device(device)
    found = [_one_view(position, normal, view, tree, offset, device) for view in views]
    point, direction, colour, saturated = (np.concatenate(part) for part in zip(*found, strict=True))
    shuffled = random.permutation(len(point))
    order = shuffled[np.argsort(point[shuffled], kind="stable")]
    count = np.bincount(point, minlength=len(position))
    rank = np.arange(len(point)) - np.repeat(np.cumsum(count) - count, count)
    kept = order[(rank < most) & (count[point[order]] >= least)]
    chosen = np.flatnonzero(count >= least)
    number = np.full(len(position), -1)
    number[chosen] = np.arange(len(chosen))
    parts = (position[chosen], normal[chosen], number[point[kept]], direction[kept], colour[kept], saturated[kept])
    tensors = (torch.from_numpy(np.ascontiguousarray(part)).to(device) for part in parts)
    return MultiViewSamples(*tensors), torch.from_numpy(chosen).to(device)


def _one_view(position, normal, view: View, tree: Tree, offset: float, device: torch.device) -> tuple[np.ndarray, ...]:
    """Index, direction, colour and saturation of the points that one photograph shows."""
    camera = view.camera
    seen = position @ camera.world_to_cv[:3, :3].T + camera.world_to_cv[:3, 3]
    depth = np.maximum(seen[:, 2], 1e-9)
    place = np.stack([camera.fy * seen[:, 1] / depth + camera.cy, camera.fx * seen[:, 0] / depth + camera.cx], 1) - 0.5  # row, column
    direction = camera.centre - position
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inside = (seen[:, 2] > 0) & (place >= 0).all(1) & (place < (camera.height - 1, camera.width - 1)).all(1)
    index = np.flatnonzero(inside & ((direction * normal).sum(1) > FACING))
    if view.alpha is not None:
        index = index[np.min([view.alpha[at] for at, _ in _corners(place[index])], axis=0) > INSIDE]
    rays = position[index] + offset * normal[index], direction[index]
    origin, towards = (torch.from_numpy(a.astype(np.float32)).to(device) for a in rays)
    index = index[transmittance(tree, origin, towards).cpu().numpy() > FREE]
    corners = _corners(place[index])
    colour = sum(decode_srgb(view.colour[at].astype(np.float64)) * share[:, None] for at, share in corners)
    saturated = np.any([view.colour[at] >= SATURATED for at, _ in corners], axis=0)
    return index, direction[index].astype(np.float32), np.asarray(colour, np.float32), saturated


def _corners(place: np.ndarray) -> list[tuple[tuple[np.ndarray, np.ndarray], np.ndarray]]:
    """The four pixels around places (N, 2), counted in pixel centres: their rows and columns, and their bilinear shares (N,)."""
    whole = place.astype(int)
    row, column = whole.T
    down, across = (place - whole).T
    return [((row + i, column + j), (down if i else 1 - down) * (across if j else 1 - across)) for i in (0, 1) for j in (0, 1)]
