# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-view samples: radiance of surface points in several training views each.

Differences between the views of one point are due to gloss, which shows the light without knowledge of the albedo.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ....io.srgb import decode_srgb
from ....kernels.trace import Tree, transmittance
from ....scene.dataset import View, light_rotations
from ...common.mask_band import narrowest_mask
from ...common.training_view import SATURATED

FACING = 0.15  # least cosine between normal and view direction; grazing views see the silhouette rather than the point
VISIBLE = 0.5  # least transmittance towards the camera
INSIDE = 0.99  # least mask opacity of the pixels around a point, so that no background is mixed into its colour


@dataclass(frozen=True, eq=False)
class MultiViewSamples:
    """P surface points and K samples of their radiance; the samples of a point are adjacent.

    Attributes:
        position: (P, 3) float32, world.
        normal: (P, 3) float32 unit, outward.
        point: (K,) int64 index of the sample's point, ascending.
        view: (K, 3) unit, towards the camera.
        colour: (K, 3) linear radiance.
        saturated: (K, 3) bool, where the radiance is only a lower bound.
        image: (K,) int64 number of the sample's view; None where the light is the same in all views.
    """

    position: torch.Tensor
    normal: torch.Tensor
    point: torch.Tensor
    view: torch.Tensor
    colour: torch.Tensor
    saturated: torch.Tensor
    image: torch.Tensor | None = None

    @property
    def lengths(self) -> torch.Tensor:
        """(P,) number of samples of each point."""
        return torch.bincount(self.point, minlength=len(self.position))

    def part(self, begin: int, end: int) -> MultiViewSamples:
        """Return the points begin..end and their samples.

        Args:
            begin: first point.
            end: one past the last point.
        """
        first, last = (int(k) for k in torch.searchsorted(self.point, torch.tensor([begin, end], device=self.point.device)))
        rows = slice(first, last)
        point = self.point[rows] - begin
        image = None if self.image is None else self.image[rows]
        of_points = (self.position[begin:end], self.normal[begin:end])
        return MultiViewSamples(*of_points, point, self.view[rows], self.colour[rows], self.saturated[rows], image)

    def every(self, step: int) -> MultiViewSamples:
        """Return each `step`-th point and its samples."""
        rows = self.point % step == 0
        image = None if self.image is None else self.image[rows]
        of_points = (self.position[::step].contiguous(), self.normal[::step].contiguous())
        return MultiViewSamples(*of_points, self.point[rows] // step, self.view[rows], self.colour[rows], self.saturated[rows], image)

    def sums(self, values: torch.Tensor) -> torch.Tensor:
        """Sum values (K, ...) of samples over each point, always in the same order: (P, ...)."""
        return torch.segment_reduce(values, "sum", lengths=self.lengths, axis=0, unsafe=True)


def sample_views(
    position: np.ndarray,
    normal: np.ndarray,
    views: Sequence[View],
    tree: Tree,
    offset: float,
    random: np.random.Generator,
    most: int,
    least: int = 3,
    device: torch.device | str = "cpu",
    image_of: Callable[[View], np.ndarray] = lambda view: view.colour,
) -> tuple[MultiViewSamples, torch.Tensor]:
    """Sample the images that see each of P surface points.

    Args:
        position: (P, 3) float32 points of the surface, world.
        normal: (P, 3) float32 unit normals.
        views: images.
        tree: the surfels that may occlude a point.
        offset: distance along the normal, world units, that clears the surface's own surfels.
        random: of the choice among the views of a point.
        most: samples per point, at most.
        least: points seen by fewer views are left out.
        device: of the tree and of the result.
        image_of: gives the sRGB-encoded image (H, W, 3) of a view to sample; by default its photograph.

    Returns:
        The samples, and the indices of their points among the P given ones.
    """
    device = torch.device(device)
    found = [_sample_view(position, normal, view, image_of, tree, offset, device) for view in views]
    point, direction, colour, saturated = (np.concatenate(part) for part in zip(*found, strict=True))
    image = np.repeat(np.arange(len(views)), [len(part[0]) for part in found])
    shuffled = random.permutation(len(point))
    order = shuffled[np.argsort(point[shuffled], kind="stable")]
    count = np.bincount(point, minlength=len(position))
    rank = np.arange(len(point)) - np.repeat(np.cumsum(count) - count, count)
    kept = order[(rank < most) & (count[point[order]] >= least)]
    chosen = np.flatnonzero(count >= least)
    number = np.full(len(position), -1)
    number[chosen] = np.arange(len(chosen))
    parts = [position[chosen], normal[chosen], number[point[kept]], direction[kept], colour[kept], saturated[kept]]
    if light_rotations(views) is not None:
        parts.append(image[kept])
    tensors = (torch.from_numpy(np.ascontiguousarray(part)).to(device) for part in parts)
    return MultiViewSamples(*tensors), torch.from_numpy(chosen).to(device)


def _sample_view(
    position, normal, view: View, image_of: Callable[[View], np.ndarray], tree: Tree, offset: float, device: torch.device
) -> tuple[np.ndarray, ...]:
    """Return index (M,), direction (M, 3), linear colour (M, 3) and saturation (M, 3) of the points (P, 3) that one image shows."""
    camera = view.camera
    local = position @ camera.world_to_cv[:3, :3].T + camera.world_to_cv[:3, 3]
    depth = np.maximum(local[:, 2], 1e-9)
    place = np.stack([camera.fy * local[:, 1] / depth + camera.cy, camera.fx * local[:, 0] / depth + camera.cx], 1) - 0.5  # row, column
    direction = camera.centre - position
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    inside = (local[:, 2] > 0) & (place >= 0).all(1) & (place < (camera.height - 1, camera.width - 1)).all(1)
    index = np.flatnonzero(inside & ((direction * normal).sum(1) > FACING))
    if view.alpha is not None:
        mask = narrowest_mask(view)
        index = index[np.min([mask[at] for at, _ in _bilinear(place[index])], axis=0) > INSIDE]
    rays = position[index] + offset * normal[index], direction[index]
    origin, towards = (torch.from_numpy(a.astype(np.float32)).to(device) for a in rays)
    index = index[transmittance(tree, origin, towards).cpu().numpy() > VISIBLE]
    corners, image = _bilinear(place[index]), image_of(view)
    colour = sum(decode_srgb(image[at].astype(np.float64)) * weight[:, None] for at, weight in corners)
    saturated = np.any([image[at] >= SATURATED for at, _ in corners], axis=0)
    return index, direction[index].astype(np.float32), np.asarray(colour, np.float32), saturated


def _bilinear(place: np.ndarray) -> list[tuple[tuple[np.ndarray, np.ndarray], np.ndarray]]:
    """Return rows, columns and bilinear weights (N,) of the four pixels around places (N, 2) given in rows and columns of centres."""
    whole = place.astype(int)
    row, column = whole.T
    down, across = (place - whole).T
    return [((row + i, column + j), (down if i else 1 - down) * (across if j else 1 - across)) for i in (0, 1) for j in (0, 1)]
