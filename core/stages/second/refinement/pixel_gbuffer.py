# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixel G-buffer: normals and materials of the pixels that a refinement step shades, from cached hits or by rasterising whole views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from ....kernels.rasterize import EXTRA, NORMAL, rasterize
from ....kernels.trace import HitLists, blend
from ....scene.camera import Camera
from ....scene.gaussians import Gaussians
from .pixel_pool import PixelPool, select_rays_and_gaussians


class CachedHits:
    """Blends the cached surfels of each pixel: geometry is frozen, so that a pixel's surfels and weights never change."""

    def __init__(self, pool: PixelPool, side: torch.Tensor) -> None:
        """Keep references.

        Args:
            pool: pixels with their hit lists.
            side: (N,) +1 or -1 per Gaussian, factor that makes its normal face the cameras.
        """
        self._pool, self._side = pool, side

    def choose_pixels(self, among: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
        """Draw the pixels of the next step, with replacement.

        Args:
            among: (B,) pixels to draw from.
            count: number of pixels.
            generator: random generator of the draw.

        Returns:
            (count,) pixels.
        """
        return among[torch.randint(len(among), (count,), generator=generator, device=generator.device)]

    def sums(self, gaussians: Gaussians, pixels: torch.Tensor) -> torch.Tensor:
        """Blend normals and materials.

        Args:
            gaussians: current values.
            pixels: (B,) indices in the pool.

        Returns:
            (B, 8) normal (3), albedo (3), roughness, metallic; not divided by opacity.
        """
        if not isinstance(self._pool.lists, HitLists):  # on a GPU all surfels: the host would wait for the number of those hit
            return blend(self._pool.lists, torch.cat([gaussians.normals() * self._side, gaussians.materials()]), pixels)
        lists, hit = select_rays_and_gaussians(self._pool.lists, pixels.numpy())
        index = torch.from_numpy(hit).long()
        few = replace(gaussians, quaternion=gaussians.quaternion.index_select(1, index), material=gaussians.material.index_select(1, index))
        return blend(lists, torch.cat([few.normals() * self._side[index], few.materials()]))


class RasterizedViews:
    """Rasterises whole views in each step and picks the pixels, as moving geometry would require; the reference for `CachedHits`."""

    def __init__(self, pool: PixelPool, cameras: Sequence[Camera], scene_radius: float) -> None:
        """Keep references.

        Args:
            pool: pixels.
            cameras: cameras of the pool's views.
            scene_radius: world units.
        """
        self._pool, self._cameras, self._radius = pool, cameras, scene_radius

    def choose_pixels(self, among: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
        """Draw the pixels of the next step, all from one view: see `CachedHits.choose_pixels`.

        Args:
            among: (B,) pixels to draw from.
            count: number of pixels.
            generator: random generator of the draw.

        Returns:
            (count,) pixels.
        """
        number = self._pool.number[among]
        same = among[number == number[torch.randint(len(among), (1,), generator=generator, device=generator.device)]]
        return same[torch.randint(len(same), (count,), generator=generator, device=generator.device)]

    def sums(self, gaussians: Gaussians, pixels: torch.Tensor) -> torch.Tensor:
        """Blend normals and materials: see `CachedHits.sums`.

        Args:
            gaussians: current values.
            pixels: (B,) indices in the pool.

        Returns:
            (B, 8) normal (3), albedo (3), roughness, metallic; not divided by opacity.
        """
        g, number = gaussians, self._pool.number[pixels]
        out = torch.zeros(len(pixels), 8, device=pixels.device)
        for view in number.unique().tolist():
            of_view = torch.nonzero(number == view)[:, 0]
            shape = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh.detach(), g.materials())
            image, _ = rasterize(*shape, self._cameras[view], self._radius, subpixels=self._pool.subpixels)
            layers = torch.cat([image[NORMAL], image[EXTRA : EXTRA + 5]]).flatten(1)
            out = out.index_copy(0, of_view, layers[:, self._pool.place[pixels[of_view]]].T)
        return out
