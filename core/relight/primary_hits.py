# SPDX-License-Identifier: GPL-3.0-or-later
"""Primary hits: the surface points of the Gaussians that a camera sees."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import torch

from ..rendering.deferred import surface_pixels
from ..rendering.gbuffer import rasterize_view
from ..scene.camera import Camera
from ..scene.gbuffer import EMPTY_ALPHA
from ..scene.reconstruction import Reconstruction


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

    def only(self, which: torch.Tensor) -> PrimaryHits:
        """Return some of the points, by ascending indices (K,)."""
        rows = {f.name: getattr(self, f.name)[which] for f in dataclasses.fields(self) if f.name not in ("camera", "coverage")}
        return dataclasses.replace(self, **rows)

    def composite(self, colour: torch.Tensor) -> torch.Tensor:
        """Return straight colours of the points, (P, 3), as a linear premultiplied image (H, W, 4)."""
        rgba = colour.new_zeros(self.coverage.numel(), 4)
        rgba[self.index, :3] = colour * self.alpha[:, None]
        rgba[:, 3] = self.coverage.flatten()
        return rgba.view(*self.coverage.shape, 4)


def primary_hits(reconstruction: Reconstruction, camera: Camera, albedo_scale: torch.Tensor) -> PrimaryHits:
    """Rasterise the Gaussians and divide by opacity.

    Args:
        reconstruction: Gaussians with materials.
        camera: the camera.
        albedo_scale: (3,) factors of the albedo.
    """
    image, rays = rasterize_view(reconstruction, camera)
    with torch.no_grad():
        p = surface_pixels(image, rays, EMPTY_ALPHA)
        ray = rays.flatten(1)[:, p.index].T.contiguous()
        depth = image[-2].flatten()[p.index] / p.alpha
        point = torch.from_numpy(camera.centre).to(depth) + depth[:, None] * ray
        materials = (p.albedo * albedo_scale, p.roughness, p.metallic, p.alpha)
        return PrimaryHits(camera, p.index, ray, p.view, point, depth, p.normal.contiguous(), *materials, image[-1].contiguous(), point)
