# SPDX-License-Identifier: GPL-3.0-or-later
"""Dependence of the photographs on the light: how much light from each direction reaches their pixels, by the run's surface and materials.

s(w) = sum over pixels of V(w) n.w [(1 - m)(1 - E_s) a / pi + F D V_s], per steradian, over its mean. Where s is 0, no method can find the
light in the photographs. The converse does not hold: a matt surface depends on all light above it, but shows it blurred.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from ..relight.primary_hits import PrimaryHits, primary_hits
from ..relight.sample_counts import pixel_shifts
from ..rendering.secondary_rays import SecondaryTracer
from ..scene.camera import Camera
from ..scene.camera_files import PlacedCamera
from ..scene.reconstruction import Reconstruction
from ..scene.surroundings import Surroundings
from ..shading.brdf import base_reflectance, bend_view_to_normal, ggx_alpha, specular_lobe
from ..shading.environment_lookup import direction_to_uv, lookup, solid_angles, texel_directions, to_light_frame
from ..shading.light_distribution import LightDistribution
from ..shading.sampling import draw
from ..shading.specular_albedo import diffuse_fraction
from .cases import spread

ROWS = 16  # of the map: texels of 11 degrees, somewhat finer than those of the second stage's light before it splits them
VIEWS, POINTS = 16, 256  # photographs, evenly spread, and points of each: others move the part by under .3 % of the sphere
SIDE = 160  # pixels of a photograph's longest side at most, from which the points are chosen
SAMPLES = (64, 64, 0)  # directions at each point: by the cosine, by GGX visible normals, by the light
# Of the mean dependence, from which on a direction counts as constrained. The part hardly changes with it: .05, .1 and .2 leave 81, 80 and
# 78 % of the sphere of capture_ogre on its table, 100, 100 and 98 % of rocker_corner, which is photographed from all sides.
CONSTRAINED = 0.1


@torch.no_grad()
def light_dependence(
    reconstruction: Reconstruction, photographs: Sequence[PlacedCamera], surroundings: Surroundings | None = None
) -> np.ndarray:
    """Estimate how much the pixels of photographs depend on the light from each direction.

    Args:
        reconstruction: finished run.
        photographs: that it was made from, with their cameras.
        surroundings: near surfaces that hide light from the object, in the world; None: there are none.

    Returns:
        Lat-long map (ROWS, 2 ROWS) per steradian, over its mean on the sphere; all 0 where the photographs show no surface.
    """
    tracer = SecondaryTracer(reconstruction, surroundings)
    total = torch.zeros(ROWS * 2 * ROWS, dtype=torch.float64, device=tracer.device)
    for number in spread(len(photographs), VIEWS):
        one = photographs[number]
        hits, pixels = _points(reconstruction, one.camera)
        direction, light = _light_of_directions(reconstruction, hits, tracer)
        rotation = None if one.light_rotation is None else torch.from_numpy(one.light_rotation).to(direction)
        u, v = direction_to_uv(to_light_frame(direction, rotation))
        texel = (v * ROWS).long().clamp(0, ROWS - 1) * 2 * ROWS + (u * 2 * ROWS).long().clamp(0, 2 * ROWS - 1)
        total.index_add_(0, texel, light.double() * pixels)
    angle = solid_angles(ROWS, 2 * ROWS, torch.float64, total.device)[:, None]
    mean = total.sum() / (4 * math.pi)
    return (total.view(ROWS, 2 * ROWS) / angle / mean.clamp_min(1e-30)).cpu().numpy()


def constrained_part(dependence: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return the directions that the photographs constrain: those of at least CONSTRAINED times the mean dependence.

    Args:
        dependence: (ROWS, 2 ROWS) from `light_dependence`.
        height: rows of the result.
        width: columns of the result.

    Returns:
        (height, width) bool, of a lat-long map.
    """
    return on_texels(dependence, height, width) >= CONSTRAINED


def on_texels(dependence: np.ndarray, height: int, width: int) -> np.ndarray:
    """Interpolate a lat-long map (H, W) bilinearly at the texels of a larger one, (height, width)."""
    direction = texel_directions(height, width).view(-1, 3)
    return lookup(torch.from_numpy(dependence.astype(np.float32))[..., None], direction).view(height, width).numpy()


def sphere_mean(values: np.ndarray) -> float:
    """Return the mean over the sphere of a lat-long map (H, W); of one of bool, the fraction of the sphere."""
    height, width = values.shape
    angle = solid_angles(height, width, torch.float64).numpy()[:, None]
    return float((angle * values).sum() / (4 * math.pi))


def _points(reconstruction: Reconstruction, camera: Camera) -> tuple[PrimaryHits, float]:
    """Return POINTS of the object that a camera sees, evenly spread over its pixels, and the pixels that each stands for."""
    reduction = max(1.0, max(camera.width, camera.height) / SIDE)
    small = camera.resized(round(camera.width / reduction), round(camera.height / reduction))
    hits = primary_hits(reconstruction, small, torch.ones(3, device=reconstruction.environment.device))
    distance = (hits.point - hits.point.new_tensor(reconstruction.bound.centre)).norm(dim=1)
    seen = torch.nonzero(distance <= reconstruction.bound.radius)[:, 0]  # what lies beyond is a backdrop, part of the distant light
    chosen = hits.only(seen[spread(len(seen), POINTS)])
    return chosen, reduction**2 * len(seen) / max(1, len(chosen.index))


def _light_of_directions(reconstruction: Reconstruction, hits: PrimaryHits, tracer: SecondaryTracer) -> tuple[torch.Tensor, torch.Tensor]:
    """Draw directions at P points by their BRDF, and estimate the light that pixels receive through each.

    Returns:
        (P N, 3) unit directions, and (P N,) radiance of the pixel under a light of radiance 1: their sum over N is the directional albedo,
        less what is hidden. Mean over the channels.
    """
    shift, count = pixel_shifts(hits.index, hits.camera.width), sum(SAMPLES)
    drawn = draw(hits.view, hits.normal, hits.roughness, SAMPLES, LightDistribution(reconstruction.environment), shift)
    view = bend_view_to_normal(hits.view, hits.normal)
    cosine, lobe, weight = specular_lobe(view, hits.normal, ggx_alpha(hits.roughness), drawn.direction)
    metallic = hits.metallic[:, None]
    f0 = base_reflectance(hits.albedo, metallic).mean(1, keepdim=True)
    passed = diffuse_fraction((view * hits.normal).sum(1), hits.roughness)[:, None]
    diffuse = (1 - metallic) * hits.albedo.mean(1, keepdim=True) * passed / math.pi
    reflected = (diffuse + (f0 + (1 - f0) * weight) * lobe) * cosine.clamp_min(0) / (count * drawn.density)
    direction, light = drawn.direction.reshape(-1, 3), (hits.alpha[:, None] * reflected).flatten()
    above = torch.nonzero(light > 0)[:, 0]
    origin = tracer.above(hits.point, hits.normal)[above // count].contiguous()
    visible, _ = tracer.look(origin, direction[above].contiguous())
    return direction[above], light[above] * visible
