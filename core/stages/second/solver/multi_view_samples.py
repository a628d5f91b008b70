# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-view samples: radiance of surface points in several training views each.

Differences between the views of one point are due to gloss, which shows the light without knowledge of the albedo.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from ....io.srgb import decode_srgb
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.dataset import View, light_rotations
from ...common.training_view import MIN_SATURATED
from .view_choice import ViewChoice, bilinear_pixels, choose_views, image_places


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

    @cached_property
    def n_v(self) -> torch.Tensor:
        """(K,) cosine between normal and view direction, at least 0.001."""
        return (self.normal[self.point] * self.view).sum(1).clamp_min(1e-3)

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

    def subset(self, kept: torch.Tensor) -> MultiViewSamples:
        """Return the points `kept` (P,) bool and their samples."""
        rows = kept[self.point]
        point = (kept.cumsum(0) - 1)[self.point[rows]]
        image = None if self.image is None else self.image[rows]
        return MultiViewSamples(
            self.position[kept], self.normal[kept], point, self.view[rows], self.colour[rows], self.saturated[rows], image
        )

    def sums(self, values: torch.Tensor) -> torch.Tensor:
        """Sum values (K, ...) of samples over each point, always in the same order: (P, ...)."""
        return torch.segment_reduce(values, "sum", lengths=self.lengths, axis=0, unsafe=True)


def sample_views(
    position: np.ndarray,
    normal: np.ndarray,
    views: Sequence[View],
    tracer: SecondaryTracer,
    random: np.random.Generator,
    most: int,
    least: int = 3,
) -> tuple[MultiViewSamples, torch.Tensor]:
    """Sample the photographs that see each of N surface points.

    Args:
        position: (N, 3) float32 points of the surface, world.
        normal: (N, 3) float32 unit normals.
        views: images.
        tracer: tracer of the surfels that may occlude a point; the result is on its device.
        random: random generator of the choice among the views of a point.
        most: samples per point, at most.
        least: points seen by fewer views are left out.

    Returns:
        The samples, and the indices of their points among the N given ones.
    """
    choice = choose_views(position, normal, views, tracer, random, most, least)
    images = (view.colour for view in views)
    samples = sample_images(position, normal, views, images, choice, tracer.device)
    return samples, torch.from_numpy(choice.chosen).to(tracer.device)


def sample_images(
    position: np.ndarray,
    normal: np.ndarray,
    views: Sequence[View],
    images: Iterable[np.ndarray],
    choice: ViewChoice,
    device: torch.device | str = "cpu",
) -> MultiViewSamples:
    """Sample images at the points of a choice of views.

    Args:
        position: (N, 3) float32 points of the surface, world.
        normal: (N, 3) float32 unit normals.
        views: supply the cameras.
        images: sRGB-encoded image (H, W, 3) of each view, in order; each is read once.
        choice: points and views.
        device: device of the result.
    """
    at = position[choice.chosen[choice.point]]
    direction, colour = np.empty_like(at), np.empty_like(at)
    saturated = np.empty(at.shape, bool)
    by_view = np.argsort(choice.view, kind="stable")
    first = np.searchsorted(choice.view[by_view], np.arange(len(views) + 1))
    for number, (view, image) in enumerate(zip(views, images, strict=True)):
        rows = by_view[first[number] : first[number + 1]]
        towards = view.camera.centre - at[rows]
        direction[rows] = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        pixels = bilinear_pixels(image_places(at[rows], view.camera)[0])
        colour[rows] = sum(decode_srgb(image[pixel].astype(np.float64)) * weight[:, None] for pixel, weight in pixels)
        saturated[rows] = np.any([image[pixel] >= MIN_SATURATED for pixel, _ in pixels], axis=0)
    parts = [position[choice.chosen], normal[choice.chosen], choice.point, direction, colour, saturated]
    if light_rotations(views) is not None:
        parts.append(choice.view)
    return MultiViewSamples(*(torch.from_numpy(np.ascontiguousarray(part)).to(device) for part in parts))
