# SPDX-License-Identifier: GPL-3.0-or-later
"""Deferred shading: from the sums of the rasteriser to the image of a camera.

Order: divide by opacity, add the split-sum reflection of the light, composite over the background. The reflective model is that of
Ref-Gaussian (ICLR 2025), evaluated in linear light.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import torch

from ..io.srgb import encode_srgb
from ..kernels.rasterize import COLOUR, EXTRA, NORMAL
from ..kernels.split_sum import shade_pixels
from ..machine.backend import by_warp
from ..scene.unit_vectors import unit_vectors
from ..shading.environment_lookup import lookup, to_light_frame
from ..shading.specular_albedo import brdf_table
from ..shading.split_sum import level_roughness, specular_light, specular_radiance

ALPHA_FLOOR = 1e-4  # smallest opacity that sums are divided by
REFLECTING = 0.05  # opacity above which a pixel reflects; fainter ones show their SH colour


@dataclass
class SurfacePixels:
    """Covered pixels of an image as P surface points.

    Attributes:
        index: (P,) flat pixel index.
        view: (P, 3) unit vector towards the camera.
        normal: (P, 3) unit.
        colour: (P, 3) linear radiance of the SH.
        albedo: (P, 3) linear, 0..1.
        roughness: (P,) in 0..1.
        metallic: (P,) in 0..1.
        alpha: (P,) opacity in 0..1.
    """

    index: torch.Tensor
    view: torch.Tensor
    normal: torch.Tensor
    colour: torch.Tensor
    albedo: torch.Tensor
    roughness: torch.Tensor
    metallic: torch.Tensor
    alpha: torch.Tensor


def surface_pixels(image: torch.Tensor, rays: torch.Tensor, threshold: float = REFLECTING, all_pixels: bool = False) -> SurfacePixels:
    """Divide the sums of `rasterize` by opacity where the opacity exceeds a threshold.

    Args:
        image: (13, H, W) sums; the extra channels are albedo (3), roughness, metallic.
        rays: (3, H, W) world directions of any length.
        threshold: smallest opacity of a covered pixel.
        all_pixels: return all pixels and divide fainter ones by the threshold: on a GPU this avoids waiting for the number of covered
            pixels.
    """
    flat = image.flatten(1)
    index = torch.arange(flat.shape[1], device=flat.device) if all_pixels else torch.nonzero(flat[-1].detach() > threshold)[:, 0]
    sums = flat if all_pixels else flat[:, index]
    mean = sums[:-1] / (sums[-1].clamp_min(threshold) if all_pixels else sums[-1])
    view = -unit_vectors(rays.flatten(1)[:, index]).T
    normal = unit_vectors(mean[NORMAL]).T
    colour, albedo = mean[COLOUR].T, mean[EXTRA : EXTRA + 3].T
    return SurfacePixels(index, view, normal, colour, albedo, mean[EXTRA + 3], mean[EXTRA + 4], sums[-1])


@cache
def _tables(device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the roughness of each level (L,) and the table of the BRDF (T, T, 2) on a device."""
    return level_roughness().to(device), brdf_table("principled").to(device)


def _shaded(
    image: torch.Tensor, rays: torch.Tensor, stack: torch.Tensor, light_rotation: torch.Tensor | None, mirrored: torch.Tensor | None = None
) -> torch.Tensor:
    """Return the radiance (3, H, W) that the kernels compute; without levels in the stack nothing reflects."""
    return shade_pixels(image, rays, stack, light_rotation, _tables(image.device), (REFLECTING, ALPHA_FLOOR), mirrored)


def splat_radiance(image: torch.Tensor) -> torch.Tensor:
    """Return the radiance of the SH colours, (3, H, W) linear with straight alpha, from the sums of `rasterize`, (13, H, W)."""
    return image[COLOUR] / image[-1:].clamp_min(ALPHA_FLOOR)


def reflective_radiance(
    image: torch.Tensor,
    rays: torch.Tensor,
    stack: torch.Tensor,
    light_rotation: torch.Tensor | None = None,
    mirrored: torch.Tensor | None = None,
) -> torch.Tensor:
    """Add the split-sum reflection of the light to the diffuse SH radiance: (1 - m) C_sh + S (Ref-Gaussian, in linear light).

    With what mirrored rays meet, the light L in S is V L + L_ind. Pixels of opacity up to REFLECTING keep their SH radiance.

    Args:
        image: (13, H, W) sums of `rasterize`.
        rays: (3, H, W) world directions of any length.
        stack: (L, h, w, 3) prefiltered light of `specular_light`.
        light_rotation: (3, 3) world to the frame of the light, None where it stands still.
        mirrored: (4, H, W) transmittance V along the mirrored direction and radiance L_ind of what blocks it, without a gradient; None:
            nothing does.

    Returns:
        (3, H, W) linear radiance with straight alpha. The image and the stack have gradients.
    """
    if image.dtype == torch.float32:  # which the kernels compute in
        return _shaded(image, rays, stack, light_rotation, mirrored)
    return reflective_radiance_reference(image, rays, stack, light_rotation, mirrored)


def reflective_radiance_reference(
    image: torch.Tensor,
    rays: torch.Tensor,
    stack: torch.Tensor,
    light_rotation: torch.Tensor | None = None,
    mirrored: torch.Tensor | None = None,
) -> torch.Tensor:
    """Compute `reflective_radiance` in PyTorch operations, for any floating type and device: its reference implementation.

    Args:
        image: (13, H, W) sums of `rasterize`.
        rays: (3, H, W) world directions of any length.
        stack: (L, h, w, 3) prefiltered light.
        light_rotation: (3, 3) world to the frame of the light, None where it stands still.
        mirrored: (4, H, W) transmittance and radiance of what mirrored rays meet; None: nothing.
    """
    all_pixels = by_warp(image)
    p = surface_pixels(image, rays, all_pixels=all_pixels)
    view, normal = to_light_frame(p.view, light_rotation), to_light_frame(p.normal, light_rotation)
    met = None if mirrored is None else mirrored.flatten(1)[:, p.index].T
    light = specular_radiance(view, normal, p.albedo, p.roughness, p.metallic, stack, met)
    shaded = (1 - p.metallic[:, None]) * p.colour + light
    base = splat_radiance(image)
    if all_pixels:
        return torch.where(image[-1] > REFLECTING, shaded.T.view_as(base), base)
    return base.flatten(1).index_copy(1, p.index, shaded.T).view_as(base)


def radiance(
    image: torch.Tensor,
    rays: torch.Tensor,
    light: torch.Tensor | None,
    light_rotation: torch.Tensor | None = None,
    mirrored: torch.Tensor | None = None,
) -> torch.Tensor:
    """Return the radiance of an image before compositing, with or without reflections.

    Args:
        image: (13, H, W) sums of `rasterize`.
        rays: (3, H, W) world directions of any length.
        light: (h, w, 3) linear lat-long map to reflect, or None: the SH hold the full radiance.
        light_rotation: (3, 3) world to the frame of the light, None where it stands still.
        mirrored: (4, H, W) transmittance V along the mirrored direction and radiance L_ind of what blocks it, without a gradient; None:
            nothing does.

    Returns:
        (3, H, W) linear radiance with straight alpha.
    """
    if light is not None:
        return reflective_radiance(image, rays, specular_light(light), light_rotation, mirrored)
    return _shaded(image, rays, image.new_empty(0, 1, 1, 3), None) if image.dtype == torch.float32 else splat_radiance(image)


def background_radiance(background: torch.Tensor, rays: torch.Tensor, light_rotation: torch.Tensor | None = None) -> torch.Tensor:
    """Look a background up along rays; it stands still in the frame of the light.

    Args:
        background: (h, w, 3) linear lat-long map.
        rays: (3, H, W) world directions of any length.
        light_rotation: (3, 3) world to the frame of the light, None where it stands still.

    Returns:
        (3, H, W) linear radiance.
    """
    direction = unit_vectors(rays.flatten(1)).T
    return lookup(background, to_light_frame(direction, light_rotation)).T.view_as(rays)


def composite(
    straight: torch.Tensor,
    alpha: torch.Tensor,
    rays: torch.Tensor,
    background: torch.Tensor | None,
    light_rotation: torch.Tensor | None = None,
) -> torch.Tensor:
    """Composite an image over black or over the learned background, and encode it as sRGB.

    Args:
        straight: (3, H, W) linear radiance with straight alpha.
        alpha: (H, W) opacity in 0..1.
        rays: (3, H, W) world directions of any length.
        background: (h, w, 3) linear lat-long map, composited in linear light; None where masks separate the object from its background:
            the encoded image is composited over black.
        light_rotation: (3, 3) world to the frame of the light, None where it stands still.

    Returns:
        (3, H, W) sRGB-encoded image.
    """
    if background is None:
        return encode_srgb(straight) * alpha
    return encode_srgb(straight * alpha + background_radiance(background, rays, light_rotation) * (1 - alpha))
