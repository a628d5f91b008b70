# SPDX-License-Identifier: GPL-3.0-or-later
"""Primary hits: the surface points of the Gaussians that a camera sees."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.rasterize import NORMAL
from ..machine.backend import send
from ..rendering.deferred import surface_pixels
from ..rendering.gbuffer import BAND, SUBPIXELS, rasterize_view, world_rays
from ..scene.camera import Camera
from ..scene.gbuffer import EMPTY_ALPHA
from ..scene.reconstruction import Reconstruction
from ..scene.unit_vectors import unit_vectors

# Length of the mean unit normal of a pixel's rays from which one point stands for all: 5 degrees between two halves.
MIN_MEAN_NORMAL = 0.999


@dataclass(frozen=True, eq=False)
class PrimaryHits:
    """P covered pixels of a view as surface points, without gradients.

    Attributes:
        camera: camera of the view.
        index: (P,) flat pixel index, ascending.
        ray: (P, 3) world direction of planar depth 1.
        view: (P, 3) unit, towards the camera.
        point: (P, 3) world.
        depth: (P,) planar.
        normal: (P, 3) unit; near silhouettes it may point slightly away from the camera.
        albedo: (P, 3) linear, 0..1.
        roughness: (P,) in 0..1.
        metallic: (P,) in 0..1.
        alpha: (P,) opacity in 0..1.
        coverage: (H, W) opacity of all pixels, including those too faint to be lit.
        origin: (P, 3) origins of secondary rays, world.
        divided: the same pixels with the rays of some apart, None where each is one point.
    """

    camera: Camera
    index: torch.Tensor
    ray: torch.Tensor
    view: torch.Tensor
    point: torch.Tensor
    depth: torch.Tensor
    normal: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor
    alpha: torch.Tensor
    coverage: torch.Tensor
    origin: torch.Tensor
    divided: DividedHits | None = None

    def only(self, which: torch.Tensor) -> PrimaryHits:
        """Return some of the points, by ascending indices (K,), undivided."""
        return dataclasses.replace(self, **{name: getattr(self, name)[which] for name in self.per_point()}, divided=None)

    def mean_albedo(self) -> torch.Tensor:
        """Return the albedo (P, 3) of the pixels, of which divided ones are the mean over their rays."""
        return self.albedo if self.divided is None else self.divided.joined(self.divided.single.albedo, self.divided.rays.albedo)

    @classmethod
    def per_point(cls) -> list[str]:
        """Return the names of the attributes with a row for each point."""
        return [f.name for f in dataclasses.fields(cls) if f.name not in ("camera", "coverage", "divided")]

    def composite(self, colour: torch.Tensor) -> torch.Tensor:
        """Return straight colours of the points, (P, 3), as a linear premultiplied image (H, W, 4)."""
        rgb = colour.new_zeros(self.coverage.numel(), 3).index_copy_(0, self.index, colour * self.alpha[:, None])
        return torch.cat([rgb.view(*self.coverage.shape, 3), self.coverage[..., None]], -1)


@dataclass(frozen=True, eq=False)
class DividedHits:
    """P pixels of a view: a single point for most, and a point for each ray of those in which the surface bends or breaks.

    A pixel is the mean over several rays. At an edge their mean normal belongs to no surface, and what it would reflect is seen nowhere.

    Attributes:
        single: the pixels that are one point.
        single_row: (K,) their rows among the P pixels.
        rays: rays of the other pixels, as hits of a camera with as many pixels as this one has rays.
        ray_row: (R,) row of each ray's pixel.
        share: (R,) of the ray in its pixel's opacity; the shares of a pixel sum to 1.
        count: P.
    """

    single: PrimaryHits
    single_row: torch.Tensor
    rays: PrimaryHits
    ray_row: torch.Tensor
    share: torch.Tensor
    count: int

    @classmethod
    def of(cls, surface: PrimaryHits, rays: PrimaryHits) -> DividedHits:
        """Divide the pixels of a surface.

        Args:
            surface: P pixels.
            rays: all rays of some of them, from `divided_hits`.
        """
        width, side = surface.camera.width, rays.camera.width // surface.camera.width
        fine_row, fine_column = rays.index // rays.camera.width, rays.index % rays.camera.width
        row = torch.searchsorted(surface.index, fine_row // side * width + fine_column // side)
        opacity = torch.zeros_like(surface.alpha).index_add(0, row, rays.alpha)
        single_row = torch.nonzero(opacity == 0)[:, 0]
        return cls(surface.only(single_row), single_row, rays, row, rays.alpha / opacity[row], len(surface.index))

    def joined(self, of_single: torch.Tensor, of_rays: torch.Tensor) -> torch.Tensor:
        """Return the values (P, C) of all pixels, of those of the single points (K, C) and those of the rays (R, C)."""
        pixels = of_single.new_zeros(self.count, of_single.shape[1])
        return pixels.index_copy(0, self.single_row, of_single).index_add(0, self.ray_row, of_rays * self.share[:, None])


def primary_hits(reconstruction: Reconstruction, camera: Camera, albedo_scale: torch.Tensor) -> PrimaryHits:
    """Rasterise the Gaussians and divide by opacity.

    Args:
        reconstruction: Gaussians with materials.
        camera: the camera.
        albedo_scale: (3,) factors of the albedo.
    """
    image, rays = rasterize_view(reconstruction, camera)
    return _hits(camera, image, rays, albedo_scale)


def divided_hits(reconstruction: Reconstruction, camera: Camera, albedo_scale: torch.Tensor) -> tuple[PrimaryHits, PrimaryHits]:
    """Rasterise the Gaussians once, for the hits of the pixels and for those of the rays of pixels in which the surface bends or breaks.

    Args:
        reconstruction: Gaussians with materials.
        camera: the camera.
        albedo_scale: (3,) factors of the albedo.

    Returns:
        The hits of the pixels as of `primary_hits`, and those of the rays, as of a camera with SUBPIXELS times the resolution.
    """
    finer = camera.resized(camera.width * SUBPIXELS, camera.height * SUBPIXELS)
    rows = max(1, BAND // (finer.width * SUBPIXELS)) * SUBPIXELS
    means, bands = [], []
    for top in range(0, finer.height, rows):
        part = finer.cropped(0, top, finer.width, min(rows, finer.height - top))
        image, rays = rasterize_view(reconstruction, part, subpixels=1)
        means.append(torch.nn.functional.avg_pool2d(image[None], SUBPIXELS)[0])
        index = torch.nonzero(_bends(image, means[-1]).flatten())[:, 0]
        hits = _hits(part, image.flatten(1)[:, index][:, None], rays.flatten(1)[:, index][:, None], albedo_scale)
        bands.append(dataclasses.replace(hits, index=index + top * finer.width, coverage=image[-1].clone()))
    joined = {name: torch.cat([getattr(band, name) for band in bands]) for name in (*PrimaryHits.per_point(), "coverage")}
    pixels = _hits(camera, torch.cat(means, 1), world_rays(camera, image.device), albedo_scale)
    return pixels, dataclasses.replace(bands[0], camera=finer, **joined)


def _bends(image: torch.Tensor, mean: torch.Tensor) -> torch.Tensor:
    """Return which rays (H, W) of sums (13, H, W) are opaque and belong to a pixel in which their normals differ.

    Args:
        image: (13, H, W) sums of the rays.
        mean: (13, H / SUBPIXELS, W / SUBPIXELS) their means over the rays of a pixel.
    """
    alpha = image[-1]
    unit = torch.nn.functional.avg_pool2d((unit_vectors(image[NORMAL]) * alpha)[None], SUBPIXELS)[0]  # as long as the rays are opaque
    bent = ((unit * unit).sum(0) < (MIN_MEAN_NORMAL * mean[-1]).square()) & (mean[-1] > 2 * EMPTY_ALPHA)
    return bent.repeat_interleave(SUBPIXELS, 0).repeat_interleave(SUBPIXELS, 1) & (alpha > EMPTY_ALPHA)


@torch.no_grad()
def _hits(camera: Camera, image: torch.Tensor, rays: torch.Tensor, albedo_scale: torch.Tensor) -> PrimaryHits:
    """Return the covered pixels of sums (13, H, W) of `rasterize_view` with its rays (3, H, W)."""
    p = surface_pixels(image, rays, EMPTY_ALPHA)
    ray = rays.flatten(1)[:, p.index].T.contiguous()
    depth = image[-2].flatten()[p.index] / p.alpha
    point = send(camera.centre.astype(np.float32), depth.device) + depth[:, None] * ray
    materials = (p.albedo * albedo_scale, p.roughness, p.metallic, p.alpha)
    return PrimaryHits(camera, p.index, ray, p.view, point, depth, p.normal.contiguous(), *materials, image[-1].contiguous(), point)
