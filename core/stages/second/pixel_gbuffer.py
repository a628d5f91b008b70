# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals and materials of the pixels that a step of the refinement shades: two ways to the same sums, the second for comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from ...kernels.rasterize import EXTRA, NORMAL, rasterize
from ...kernels.trace import HitLists, blend
from ...scene.camera import Camera
from ...scene.gaussians import Gaussians
from .pixel_pool import PixelPool, part


class CachedHits:
    """Gathers the surfels that are known for each pixel: geometry is frozen, so they never change.

    Args: side: (N,) +1 or -1, by which normals are multiplied to look at those who see them.
    """

    def __init__(self, pool: PixelPool, side: torch.Tensor) -> None:
        self._pool, self._side = pool, side

    def chosen(self, among: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
        """(count,) pixels `among` (B,) to shade next: any."""
        return among[torch.randint(len(among), (count,), generator=generator).to(among.device)]

    def sums(self, gaussians: Gaussians, pixels: torch.Tensor) -> torch.Tensor:
        """(B, 8) normal and materials, not divided by opacity."""
        if not isinstance(self._pool.lists, HitLists):  # all surfels: how many the pixels show would have to be waited for
            return blend(self._pool.lists, torch.cat([gaussians.normals() * self._side, gaussians.materials()]), pixels)
        lists, met = part(self._pool.lists, pixels.numpy())
        index = torch.from_numpy(met).long()
        few = replace(gaussians, quaternion=gaussians.quaternion.index_select(1, index), material=gaussians.material.index_select(1, index))
        return blend(lists, torch.cat([few.normals() * self._side[index], few.materials()]))


class RasterizedViews:
    """Draws whole views anew for each step and picks the pixels out, as one has to where geometry moves."""

    def __init__(self, pool: PixelPool, cameras: Sequence[Camera], scene_radius: float) -> None:
        self._pool, self._cameras, self._radius = pool, cameras, scene_radius

    def chosen(self, among: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
        """(count,) pixels `among` (B,) to shade next: all of one view."""
        number = self._pool.number[among]
        same = among[number == number[torch.randint(len(among), (1,), generator=generator).to(among.device)]]
        return same[torch.randint(len(same), (count,), generator=generator).to(among.device)]

    def sums(self, gaussians: Gaussians, pixels: torch.Tensor) -> torch.Tensor:
        """(B, 8) normal and materials, not divided by opacity."""
        g, number = gaussians, self._pool.number[pixels]
        out = torch.zeros(len(pixels), 8, device=pixels.device)
        for view in number.unique().tolist():
            here = torch.nonzero(number == view)[:, 0]
            shape = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh.detach(), g.materials())
            image, _ = rasterize(*shape, self._cameras[view], self._radius)
            wanted = torch.cat([image[NORMAL], image[EXTRA : EXTRA + 5]]).flatten(1)
            out = out.index_copy(0, here, wanted[:, self._pool.place[pixels[here]]].T)
        return out
