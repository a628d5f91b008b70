# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow of the object on a plane below it, as alpha: the fraction of the plane's light that the object takes away.

alpha = 1 - mean over channels of E / E_free, with E the irradiance of the plane beside the object, light bounced by it included, and E_free
the irradiance without it. Cycles defines the alpha of its shadow catchers so.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import torch

from ..scene.camera import Camera
from ..scene.lamps import Lamp
from .denoise import Guides, denoised
from .estimate import diffuse_albedo
from .indirect_light import ShadingPoints
from .lamp_light import lamp_sums, samples_per_lamp
from .prepared_light import PreparedLight
from .primary_hits import PrimaryHits
from .relighter import Relighter
from .sample_counts import pixel_shifts

Plane = tuple[float, float, float, float]  # unit normal n and offset d: points x with n.x = d
CLEARANCE = 0.002  # distance of ray origins from the plane, as a fraction of the scene radius
SHADOW_REACH = 8.0  # distance from the object up to which its shadow is drawn, in scene radii
MIN_COVERING_OPACITY = 0.999  # opacity of the object from which on the plane behind it is not drawn


def plane_surface(plane: Plane, camera: Camera, coverage: torch.Tensor, centre: Sequence[float], radius: float) -> PrimaryHits:
    """Return the points of a plane that a camera sees beside the object, as a white matt surface.

    Args:
        plane: the plane, in the world of the camera.
        camera: the camera.
        coverage: (H, W) opacity of the object.
        centre: centre of the scene, world.
        radius: scene radius, world units.

    Returns:
        Points at most SHADOW_REACH radii from the centre; none where the camera looks at the plane from below.
    """
    normal, ray = np.array(plane[:3]), camera.rays().reshape(-1, 3).astype(np.float64)
    below = normal @ camera.centre - plane[3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -below / (ray @ normal)
    point = camera.centre + depth[:, None] * ray
    near = np.linalg.norm(point - np.asarray(centre), axis=1) < SHADOW_REACH * radius
    seen = (below > 0) & (depth > 0) & np.isfinite(depth) & near & (coverage.flatten().cpu().numpy() < MIN_COVERING_OPACITY)
    index = np.flatnonzero(seen)
    view = -ray[index] / np.linalg.norm(ray[index], axis=1, keepdims=True)
    arrays = (ray[index], view, point[index], depth[index], np.broadcast_to(normal, (len(index), 3)))
    ray_, view_, point_, depth_, normal_ = (torch.from_numpy(a.astype(np.float32)).to(coverage.device) for a in arrays)
    ones = torch.ones_like(depth_)
    white = (torch.ones_like(point_), ones, torch.zeros_like(ones), ones)
    rows = torch.from_numpy(index).to(coverage.device)
    origin = point_ + CLEARANCE * radius * normal_
    return PrimaryHits(camera, rows, ray_, view_, point_, depth_, normal_.contiguous(), *white, coverage, origin)


def shadow_alpha(relighter: Relighter, surface: PrimaryHits, light: PreparedLight, lamps: Sequence[Lamp]) -> torch.Tensor:
    """Return the alpha of the shadow at each pixel, (H, W) in 0..1, on the CPU.

    Args:
        relighter: relighter of the object.
        surface: points of the plane, from `plane_surface`.
        light: light map.
        lamps: lamps.
    """
    light, alpha = light.to(relighter.device), torch.zeros(surface.coverage.numel())
    if not len(surface.index) or (light.distribution is None and not lamps):
        return alpha.view(*surface.coverage.shape)
    estimate = relighter.reflected(surface, light, lamps)
    black = torch.zeros_like(estimate.specular)
    matt = dataclasses.replace(estimate, specular=black, specular_split=black)
    mode = relighter.settings.denoise
    seen = matt.diffuse if mode == "off" else denoised(matt, Guides(surface, relighter.reconstruction.bound.radius), mode)
    free = light.irradiance(surface.normal) + _free_irradiance(relighter, surface, lamps)
    free = free * diffuse_albedo(surface, relighter.conserving) / math.pi
    ratio = torch.where(free > 0, seen / free.clamp_min(1e-20), 1.0).mean(1)
    alpha[surface.index.cpu()] = (1 - ratio).clamp(0, 1).cpu()
    return alpha.view(*surface.coverage.shape)


def _free_irradiance(relighter: Relighter, surface: PrimaryHits, lamps: Sequence[Lamp]) -> torch.Tensor:
    """Return the irradiance (P, 3) of lamps without occluders, of the same samples."""
    if not lamps:
        return torch.zeros_like(surface.normal)
    points = ShadingPoints.from_roughness(surface.origin, surface.view, surface.normal, surface.roughness)
    shift, free = pixel_shifts(surface.index, surface.camera.width), [dataclasses.replace(lamp, shadow=False) for lamp in lamps]
    return lamp_sums(points, free, shift, samples_per_lamp(relighter.counts, len(lamps)), relighter.query).sum(1)[:, 0]


def over_shadow(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Composite an image over its shadow.

    Args:
        image: (H, W, 4) linear premultiplied.
        alpha: (H, W) of the shadow.

    Returns:
        (H, W, 4) image: the shadow is black, so that only alpha changes.
    """
    out = image.copy()
    out[..., 3] += (1 - image[..., 3]) * alpha
    return out
