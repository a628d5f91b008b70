# SPDX-License-Identifier: GPL-3.0-or-later
"""A reconstruction seen by a camera: its layers."""

from __future__ import annotations

import numpy as np
import torch

from ..kernels.rasterize import EXTRA, rasterize
from ..scene.camera import Camera
from ..scene.gbuffer import GBuffer
from ..scene.reconstruction import Reconstruction
from .deferred import ALPHA_FLOOR, background_radiance, radiance

LIGHT_HEIGHT = 64  # rows a light map is reduced to before it is prefiltered


def rasterize_view(reconstruction: Reconstruction, camera: Camera, more: torch.Tensor | None = None) -> tuple[torch.Tensor, torch.Tensor]:
    """Sums (13, H, W) and world rays (3, H, W) of one camera, without gradients; `more` channels (E, N) follow the materials."""
    g = reconstruction.gaussians
    with torch.no_grad():
        extra = g.materials() if more is None else torch.cat([g.materials(), more])
        inputs = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra)
        image, _ = rasterize(*inputs, camera, reconstruction.bound.radius)
    return image, torch.from_numpy(camera.rays()).to(image.device).permute(2, 0, 1)


def render_gbuffer(reconstruction: Reconstruction, camera: Camera) -> GBuffer:
    """All layers of one camera."""
    mirrored, kept = reconstruction.mirrored(), reconstruction.reflections
    image, rays = rasterize_view(reconstruction, camera, None if kept is None else kept.material)
    with torch.no_grad():
        own = image if kept is None else torch.cat([image[:EXTRA], image[EXTRA + len(kept.material) :]])
        shown = radiance(own, rays, None if mirrored is None else mirrored.environment)
        alpha = image[-1]
        mean = torch.where(alpha > ALPHA_FLOOR, image[:-1] / alpha.clamp_min(ALPHA_FLOOR), 0.0)
        normal = torch.nn.functional.normalize(mean[3:6], dim=0)
        images = (alpha, mean[-1], normal, shown * (alpha > ALPHA_FLOOR), mean[6:9], mean[9], mean[10])
        behind = None
        if reconstruction.background is not None:
            behind = background_radiance(reconstruction.background, rays).permute(1, 2, 0).contiguous().cpu().numpy()
        moved = [(p.permute(1, 2, 0) if p.ndim == 3 else p).contiguous().cpu().numpy() for p in images]
    return GBuffer(camera, *moved, background=behind)


def reduced(environment: np.ndarray, height: int = LIGHT_HEIGHT) -> torch.Tensor:
    """A light map (H, W, 3) averaged down to at most `height` rows: split-sum sees nothing finer."""
    light = torch.from_numpy(np.ascontiguousarray(environment, np.float32)).permute(2, 0, 1)[None]
    if light.shape[2] > height:
        light = torch.nn.functional.interpolate(light, size=(height, 2 * height), mode="area")
    return light[0].permute(1, 2, 0).contiguous()
