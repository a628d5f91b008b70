# SPDX-License-Identifier: GPL-3.0-or-later
"""G-buffer of a camera, rasterised from a reconstruction."""

from __future__ import annotations

import numpy as np
import torch

from ..kernels.rasterize import EXTRA, NORMAL, rasterize
from ..machine.backend import send
from ..scene.camera import Camera
from ..scene.gbuffer import GBuffer
from ..scene.reconstruction import Reconstruction
from ..scene.unit_vectors import unit_vectors
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
    return image, world_rays(camera, image.device)


def world_rays(camera: Camera, device: torch.device) -> torch.Tensor:
    """Return the world rays (3, H, W) of planar depth 1 of a camera."""
    if device.type == "cpu":
        return torch.from_numpy(camera.rays()).permute(2, 0, 1)
    columns, rows = (send(part, device) for part in camera.ray_parts())
    return (rows.T[:, :, None] + columns.T[:, None]).float()


def render_gbuffer(
    reconstruction: Reconstruction,
    camera: Camera,
    light_rotation: np.ndarray | None = None,
    subpixels: int = SUBPIXELS,
    shaded: bool = True,
) -> GBuffer:
    """Render the G-buffer of a camera.

    Args:
        reconstruction: Gaussians, light and background.
        camera: the camera.
        light_rotation: (3, 3) world to the frame of the light, None where it stands still.
        subpixels: see `rasterize_view`.
        shaded: compute radiance and background; False where they are not read: they are then 0 and None.

    Returns:
        Layers (H, W) divided by opacity; radiance with split-sum includes reflections of the light it was fitted with.
    """
    fitted, known = reconstruction.reflections if shaded else None, reconstruction.confidence
    more = [rows for rows in (None if fitted is None else fitted.material, known) if rows is not None]
    image, rays = rasterize_view(reconstruction, camera, torch.cat(more) if more else None, subpixels)
    image, confidence = (image, None) if known is None else _split_confidence(image, len(known))
    if not shaded:
        black = np.broadcast_to(np.float32(0), (camera.height, camera.width, 3))
        return GBuffer(camera, *_layers(image, black), confidence=confidence)
    mirrored = reconstruction.mirrored()
    turned = None if light_rotation is None else torch.as_tensor(light_rotation, dtype=torch.float32).to(image.device)
    with torch.no_grad():
        reflecting = image if fitted is None else torch.cat([image[:EXTRA], image[EXTRA + len(fitted.material) :]])
        linear = radiance(reflecting, rays, None if mirrored is None else mirrored.environment, turned)
        linear = _channels_last(linear * (image[-1] > ALPHA_FLOOR))
        behind = None
        if reconstruction.background is not None:
            behind = _channels_last(background_radiance(reconstruction.background, rays, turned))
    return GBuffer(camera, *_layers(image, linear), background=behind, confidence=confidence)


def _split_confidence(image: torch.Tensor, count: int) -> tuple[torch.Tensor, np.ndarray]:
    """Split sums (C + count, H, W) into those without the confidence, which precedes depth and alpha, and its means (H, W, count)."""
    alpha, first = image[-1], len(image) - 2 - count
    mean = torch.where(alpha > ALPHA_FLOOR, image[first:-2] / alpha.clamp_min(ALPHA_FLOOR), 0.0)
    return torch.cat([image[:first], image[-2:]]), _channels_last(mean)


@torch.no_grad()
def _layers(image: torch.Tensor, radiance: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the layers of `GBuffer` from alpha to metallic, of the sums (13 + E, H, W) of `rasterize` and the radiance (H, W, 3)."""
    alpha = image[-1]
    mean = torch.where(alpha > ALPHA_FLOOR, image[:-1] / alpha.clamp_min(ALPHA_FLOOR), 0.0)
    normal, albedo = unit_vectors(mean[NORMAL]), mean[EXTRA : EXTRA + 3]
    flat = (part.contiguous().cpu().numpy() for part in (alpha, mean[-1], mean[EXTRA + 3], mean[EXTRA + 4]))
    opacity, depth, roughness, metallic = flat
    return opacity, depth, _channels_last(normal), radiance, _channels_last(albedo), roughness, metallic


def _channels_last(image: torch.Tensor) -> np.ndarray:
    """Convert an image (C, H, W) to an array (H, W, C) on the CPU."""
    return image.permute(1, 2, 0).contiguous().cpu().numpy()


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
