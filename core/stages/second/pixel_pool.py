# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels of all training views as surface points, with the Gaussians that make each: frozen geometry, so looked up once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch

from ...kernels.trace import HitLists, Lists, hit_lists
from ...rendering.secondary_rays import SecondaryTracer
from ...scene.dataset import View
from ..common.training_view import SATURATED

INSIDE = 0.99  # opacity of mask and Gaussians from which a pixel shows the object alone


@dataclass(frozen=True, eq=False)
class PixelPool:
    """B pixels.

    Attributes:
        lists: the Gaussians along each pixel's ray and their shares.
        opacity: (B,) of each pixel, above INSIDE.
        point: (B, 3) where the ray meets them in the mean. view: (B, 3) unit, towards the camera.
        colour: (B, 3) encoded, of the photograph. saturated: (B, 3) bool, where that is a lower bound. number: (B,) which view.
        place: (B,) flat index of the pixel in its view.
    """

    lists: Lists
    opacity: torch.Tensor
    point: torch.Tensor
    view: torch.Tensor
    colour: torch.Tensor
    saturated: torch.Tensor
    number: torch.Tensor
    place: torch.Tensor

    @property
    def count(self) -> int:
        """B."""
        return len(self.point)


def pool_pixels(views: Sequence[View], tracer: SecondaryTracer, count: int, random: np.random.Generator) -> PixelPool:
    """At most `count` pixels inside the object, as many of each view as of any other."""
    parts = [_pixels_of(view, number, tracer, max(1, count // len(views)), random) for number, view in enumerate(views)]
    lists = joined([part.lists for part in parts])
    rest = [torch.cat([getattr(part, f.name) for part in parts]) for f in fields(PixelPool)[1:]]
    return PixelPool(lists, *rest)


def _pixels_of(view: View, number: int, tracer: SecondaryTracer, count: int, random: np.random.Generator) -> PixelPool:
    camera = view.camera
    inside = np.ones((camera.height, camera.width), bool) if view.alpha is None else view.alpha > INSIDE
    index = np.flatnonzero(inside)
    index = np.sort(random.permutation(index)[: 2 * count])
    ray = torch.from_numpy(camera.rays().reshape(-1, 3)[index]).float()
    direction = torch.nn.functional.normalize(ray, dim=1).to(tracer.device)
    origin = torch.from_numpy(camera.centre).float().to(tracer.device).expand_as(direction).contiguous()
    lists = hit_lists(tracer.tree, origin, direction)
    weight, distance, length = (torch.as_tensor(a) for a in (lists.weight, lists.distance, lists.start[1:] - lists.start[:-1]))
    opacity = torch.segment_reduce(weight.double(), "sum", lengths=length, initial=0.0)
    depth = torch.segment_reduce(weight.double() * distance, "sum", lengths=length, initial=0.0) / opacity.clamp_min(1e-9)
    kept = np.flatnonzero(opacity.cpu().numpy() > INSIDE)
    kept = np.sort(random.permutation(kept)[:count])
    ray = torch.from_numpy(kept).to(tracer.device)
    colour = torch.from_numpy(view.colour.reshape(-1, 3)[index[kept]]).float().to(tracer.device)
    return PixelPool(
        chosen(lists, kept),
        opacity[ray].float(),
        origin[ray] + depth[ray].float()[:, None] * direction[ray],
        -direction[ray],
        colour,
        colour >= SATURATED,
        torch.full_like(ray, number),
        torch.from_numpy(index[kept]).to(tracer.device),
    )


def chosen(lists: Lists, rays: np.ndarray) -> Lists:
    """The lists of some of the rays, ascending."""
    if not isinstance(lists, HitLists):
        return lists.chosen(torch.from_numpy(rays).to(lists.start.device))
    length = np.diff(lists.start)
    kept = np.zeros(lists.rays, bool)
    kept[rays] = True
    hits = np.repeat(kept, length)
    start = np.concatenate([[0], np.cumsum(length[kept])])
    return HitLists(start, lists.index[hits], lists.weight[hits], lists.distance[hits], lists.left[kept])


def part(lists: HitLists, rays: np.ndarray) -> tuple[HitLists, np.ndarray]:
    """The lists of few rays, in any order, over the Gaussians that they meet, (M,), which are numbered anew: 0..M-1."""
    length = lists.start[rays + 1] - lists.start[rays]
    start = np.concatenate([[0], np.cumsum(length)])
    hits = np.repeat(lists.start[rays] - start[:-1], length) + np.arange(start[-1])
    met, index = np.unique(lists.index[hits], return_inverse=True)
    return HitLists(start, index.astype(np.int32), lists.weight[hits], lists.distance[hits], lists.left[rays]), met


def joined(parts: Sequence[Lists]) -> Lists:
    """Lists of several sets of rays, one after the other."""
    if not isinstance(parts[0], HitLists):
        return parts[0].joined(parts)
    offset = np.cumsum([0] + [len(part.index) for part in parts])
    start = np.concatenate([part.start[:-1] + o for part, o in zip(parts, offset, strict=False)] + [offset[-1:]])
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in ("index", "weight", "distance", "left")]
    return HitLists(start, *columns)
