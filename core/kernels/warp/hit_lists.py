# SPDX-License-Identifier: GPL-3.0-or-later
"""Hit lists of rays as tensors on the GPU, and their order by Gaussian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch


@dataclass(frozen=True)
class DeviceLists:
    """Hits of R rays as tensors on the device, see `HitLists`.

    Attributes:
        start: (R + 1,) int64; the hits of ray r are start[r] : start[r + 1].
        index: (H,) int32 Gaussian of each hit.
        weight: (H,) compositing weight.
        distance: (H,) distance along the ray.
        left: (R,) transmittance behind the last hit.
        of: (H,) int32 ray of each hit.
        longest: largest number of hits of a ray, or more.
    """

    start: torch.Tensor
    index: torch.Tensor
    weight: torch.Tensor
    distance: torch.Tensor
    left: torch.Tensor
    of: torch.Tensor
    longest: int

    @property
    def rays(self) -> int:
        """Number of rays, R."""
        return len(self.start) - 1

    def chosen(self, rays: torch.Tensor) -> DeviceLists:
        """Return the lists of some of the rays.

        Args:
            rays: (B,) int64 indices of rays, ascending.
        """
        length = self.start.diff()
        selected = torch.zeros_like(length, dtype=torch.bool)
        selected[rays] = True
        hits, length = selected[self.of.long()], length[rays]
        start = torch.nn.functional.pad(length.cumsum(0), (1, 0))
        of = torch.repeat_interleave(torch.arange(len(rays), device=length.device), length).int()
        return DeviceLists(start, self.index[hits], self.weight[hits], self.distance[hits], self.left[rays], of, self.longest)

    def merged(self, count: int) -> DeviceLists:
        """Return one list for each `count` consecutive rays, whose blend is the mean of theirs."""
        left = self.left.view(-1, count).mean(1)
        start, of, longest = self.start[::count].contiguous(), self.of // count, self.longest * count
        return DeviceLists(start, self.index, self.weight / count, self.distance, left, of, longest)

    def joined(self, parts: Sequence[Any]) -> DeviceLists:
        """Concatenate the lists of several sets of rays.

        Args:
            parts: the sets in order, (R_i rays, H_i hits) each; the first is this one.
        """
        start, of, hits, rays = [self.start[:1]], [], 0, 0
        for part in parts:
            start.append(part.start[1:] + hits)
            of.append(part.of + rays)
            hits, rays = hits + len(part.index), rays + part.rays
        rest = [torch.cat([getattr(part, name) for part in parts]) for name in ("index", "weight", "distance", "left")]
        return DeviceLists(torch.cat(start), *rest, torch.cat(of), max(part.longest for part in parts))


def by_gaussian(index: torch.Tensor, n: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Sort hits by Gaussian, stably.

    Args:
        index: (H,) int32 Gaussian of each hit.
        n: number of Gaussians, N.

    Returns:
        (H,) order of the hits, and (N + 1,) int32 where each Gaussian's hits begin in it.
    """
    key, order = torch.sort(index, stable=True)
    return order, torch.searchsorted(key, torch.arange(n + 1, dtype=torch.int32, device=index.device), out_int32=True)
