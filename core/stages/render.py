# SPDX-License-Identifier: GPL-3.0-or-later
"""A reconstruction seen by a camera: its layers, and its shading under any light."""

from __future__ import annotations

import numpy as np
import torch

from ..datasets.camera import Camera
from ..kernels.rasterize import EXTRA, rasterize
from ..scene.buffers import ViewBuffers
from ..scene.reconstruction import Reconstruction
from ..shading.split_sum import diffuse_light, shade, specular_light
from .deferred import ALPHA_FLOOR, background_radiance, radiance, surface_pixels

LIGHT_HEIGHT = 64  # rows a light map is reduced to before it is prefiltered


def rasterize_view(
    reconstruction: Reconstruction, camera: Camera, more: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Sums (13, H, W) and world rays (3, H, W) of one camera, without gradients; `more` channels (E, N) follow the materials."""
    g = reconstruction.gaussians
    with torch.no_grad():
        extra = g.materials() if more is None else torch.cat([g.materials(), more])
        inputs = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra)
        picture, _ = rasterize(*inputs, camera, reconstruction.bound.radius)
    return picture, torch.from_numpy(camera.rays()).permute(2, 0, 1)


def render_view(reconstruction: Reconstruction, camera: Camera) -> ViewBuffers:
    """All layers of one camera."""
    mirrored, kept = reconstruction.mirrored(), reconstruction.reflections
    picture, rays = rasterize_view(reconstruction, camera, None if kept is None else kept.material)
    with torch.no_grad():
        own = picture if kept is None else torch.cat([picture[:EXTRA], picture[EXTRA + len(kept.material) :]])
        shown = radiance(own, rays, None if mirrored is None else mirrored.environment)
        alpha = picture[-1]
        mean = torch.where(alpha > ALPHA_FLOOR, picture[:-1] / alpha.clamp_min(ALPHA_FLOOR), 0.0)
        normal = torch.nn.functional.normalize(mean[3:6], dim=0)
        pictures = (alpha, mean[-1], normal, shown * (alpha > ALPHA_FLOOR), mean[6:9], mean[9], mean[10])
        behind = None
        if reconstruction.background is not None:
            behind = background_radiance(reconstruction.background, rays).permute(1, 2, 0).contiguous().numpy()
        moved = [(p.permute(1, 2, 0) if p.ndim == 3 else p).contiguous().numpy() for p in pictures]
    return ViewBuffers(camera, *moved, background=behind)


def reduced(environment: np.ndarray, height: int = LIGHT_HEIGHT) -> torch.Tensor:
    """A light map (H, W, 3) averaged down to at most `height` rows: split-sum sees nothing finer."""
    light = torch.from_numpy(np.ascontiguousarray(environment, np.float32)).permute(2, 0, 1)[None]
    if light.shape[2] > height:
        light = torch.nn.functional.interpolate(light, size=(height, 2 * height), mode="area")
    return light[0].permute(1, 2, 0).contiguous()


def shade_view(reconstruction: Reconstruction, camera: Camera, environment: np.ndarray | None) -> np.ndarray:
    """The object under a light, (H, W, 4) float32 linear premultiplied RGBA.

    Deferred split-sum: no shadows and no inter-reflections. environment: (H, W, 3) linear lat-long; None is the recovered light.
    """
    picture, rays = rasterize_view(reconstruction, camera)
    light = reduced(reconstruction.environment_map() if environment is None else environment)
    with torch.no_grad():
        p = surface_pixels(picture, rays, ALPHA_FLOOR)
        colour = shade(p.view, p.normal, p.albedo, p.roughness, p.metallic, diffuse_light(light), specular_light(light))
        rgba = torch.zeros(4, picture[-1].numel())
        rgba[:3, p.index] = colour.T * p.alpha
        rgba[3] = picture[-1].flatten()
    return rgba.T.reshape(camera.height, camera.width, 4).numpy()
