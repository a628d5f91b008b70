# SPDX-License-Identifier: GPL-3.0-or-later
"""G-buffer of a camera, rasterised from a reconstruction."""

from __future__ import annotations

import numpy as np
import torch

from ..kernels.rasterize import EXTRA, rasterize
from ..scene.camera import Camera
from ..scene.gbuffer import GBuffer
from ..scene.reconstruction import Reconstruction
from .deferred import ALPHA_FLOOR, background_radiance, radiance

LIGHT_HEIGHT = 64  # largest number of rows of a light map when it is prefiltered
SUBPIXELS = 2  # rays along each side of a pixel
BAND = 2**22  # rays that are rasterised at once, in a band of rows


def rasterize_view(
    reconstruction: Reconstruction, camera: Camera, more: torch.Tensor | None = None, subpixels: int = SUBPIXELS
) -> tuple[torch.Tensor, torch.Tensor]:
    """Rasterise a reconstruction for one camera, without gradients.

    Args:
        reconstruction: Gaussians to rasterise; their materials are extra channels.
        camera: the camera.
        more: (E, N) further channels, which follow the materials.
        subpixels: rays along each side of a pixel, whose mean it is; 1 for depth that is fused: a mean over an edge lies on no surface.

    Returns:
        Sums (13 + E, H, W) and world rays (3, H, W) of planar depth 1.
    """
    g = reconstruction.gaussians
    with torch.no_grad():
        extra = g.materials() if more is None else torch.cat([g.materials(), more])
        inputs = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra)
        rows = max(1, BAND // (camera.width * subpixels**2))
        parts = [camera.cropped(0, top, camera.width, min(rows, camera.height - top)) for top in range(0, camera.height, rows)]
        bands = [rasterize(*inputs, part, reconstruction.bound.radius, subpixels=subpixels)[0] for part in parts]
        image = bands[0] if len(bands) == 1 else torch.cat(bands, 1)
    return image, torch.from_numpy(camera.rays()).to(image.device).permute(2, 0, 1)


def render_gbuffer(
    reconstruction: Reconstruction, camera: Camera, light_rotation: np.ndarray | None = None, subpixels: int = SUBPIXELS
) -> GBuffer:
    """Render the G-buffer of a camera.

    Args:
        reconstruction: Gaussians, light and background.
        camera: the camera.
        light_rotation: (3, 3) world to the frame of the light, None where it stands still.
        subpixels: see `rasterize_view`.

    Returns:
        Layers (H, W) divided by opacity; the radiance of a glossy reconstruction includes reflections of the light it was fitted with.
    """
    mirrored, fitted = reconstruction.mirrored(), reconstruction.reflections
    image, rays = rasterize_view(reconstruction, camera, None if fitted is None else fitted.material, subpixels)
    turned = None if light_rotation is None else torch.as_tensor(light_rotation, dtype=torch.float32).to(image.device)
    with torch.no_grad():
        reflecting = image if fitted is None else torch.cat([image[:EXTRA], image[EXTRA + len(fitted.material) :]])
        linear = radiance(reflecting, rays, None if mirrored is None else mirrored.environment, turned)
        alpha = image[-1]
        mean = torch.where(alpha > ALPHA_FLOOR, image[:-1] / alpha.clamp_min(ALPHA_FLOOR), 0.0)
        normal = torch.nn.functional.normalize(mean[3:6], dim=0)
        images = (alpha, mean[-1], normal, linear * (alpha > ALPHA_FLOOR), mean[6:9], mean[9], mean[10])
        behind = None
        if reconstruction.background is not None:
            behind = background_radiance(reconstruction.background, rays, turned).permute(1, 2, 0).contiguous().cpu().numpy()
        layers = [(p.permute(1, 2, 0) if p.ndim == 3 else p).contiguous().cpu().numpy() for p in images]
    return GBuffer(camera, *layers, background=behind)


def downsampled_light(environment: np.ndarray, height: int = LIGHT_HEIGHT) -> torch.Tensor:
    """Average a light map down to a number of rows: split-sum shading needs no finer detail.

    Args:
        environment: (H, W, 3) linear lat-long map.
        height: largest number of rows of the result; smaller maps keep their size.

    Returns:
        (h, w, 3) float32 with h = min(H, height).
    """
    light = torch.from_numpy(np.ascontiguousarray(environment, np.float32)).permute(2, 0, 1)[None]
    if light.shape[2] > height:
        light = torch.nn.functional.interpolate(light, size=(height, 2 * height), mode="area")
    return light[0].permute(1, 2, 0).contiguous()
