# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of an object whose light turns relative to it, as on a turntable.

The SH radiance of such an object is that under another light in every direction: seen from a photograph's camera, it is the radiance under
that photograph's light. Light that one part of the object throws on another leaves in directions of no camera, and the SH give no radiance
there that would belong to the light of any one photograph. The mean over the lights of all photographs stands in for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch

from ..scene.dataset import View, light_rotations
from ..scene.gaussians import Gaussians
from ..scene.reconstruction import Reconstruction, Reflections
from ..scene.spherical_harmonics import SH_C0, sh_radiance
from ..scene.unit_vectors import unit_vectors
from ..shading.environment_lookup import lookup, texel_directions, to_light_frame

GRAZING = 1e-3  # weight of a camera that a surfel does not face, so that surfels that face none have a mean too


def mean_over_lights(reconstruction: Reconstruction, views: Sequence[View]) -> Reconstruction:
    """Return a reconstruction with the mean radiance over the lights of the views, the same in all directions.

    Args:
        reconstruction: fitted to the views.
        views: training views; where their light stands still, the reconstruction itself is returned.
    """
    rotations = light_rotations(views)
    if rotations is None:
        return reconstruction
    gaussians, mirrored = reconstruction.gaussians, reconstruction.mirrored()
    sh = torch.zeros_like(gaussians.sh)
    sh[0] = (mean_radiance(gaussians, views) - 0.5) / SH_C0
    steady = replace(reconstruction, gaussians=replace(gaussians, sh=sh))
    if mirrored is None:
        return steady
    turned = torch.from_numpy(rotations).to(mirrored.environment.device)
    return replace(steady, reflections=Reflections(mirrored.material, mean_light(mirrored.environment, turned)))


def mean_radiance(gaussians: Gaussians, views: Sequence[View]) -> torch.Tensor:
    """Return the mean linear SH radiance (3, N) of surfels in the directions of the cameras, by the cosine to their normals."""
    total, weight = torch.zeros_like(gaussians.position), gaussians.position.new_zeros(gaussians.count)
    for cosine, colour in _seen_from(gaussians, views):
        share = cosine.clamp_min(GRAZING)
        total, weight = total + share * colour, weight + share
    return total / weight


def most_facing_radiance(gaussians: Gaussians, views: Sequence[View]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the SH radiance (N, 3) of surfels towards the camera that each faces most, and their normals (N, 3) in its light's frame."""
    rotations, normal = light_rotations(views), gaussians.normals().T
    assert rotations is not None
    best, chosen = gaussians.position.new_full((gaussians.count,), -2.0), torch.zeros_like(normal)
    radiance = torch.zeros_like(normal)
    for rotation, (cosine, colour) in zip(torch.from_numpy(rotations).to(normal.device), _seen_from(gaussians, views), strict=True):
        better = (cosine > best)[:, None]
        radiance, chosen = torch.where(better, colour.T, radiance), torch.where(better, to_light_frame(normal, rotation), chosen)
        best = torch.maximum(best, cosine)
    return radiance, chosen


def _seen_from(gaussians: Gaussians, views: Sequence[View]) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Yield, for the camera of each view, the cosines (N,) to the normals and the linear SH radiance (3, N) of surfels towards it."""
    normal = gaussians.normals()
    for view in views:
        centre = torch.from_numpy(view.camera.centre).to(gaussians.position)
        towards = unit_vectors(centre[:, None] - gaussians.position)
        yield (towards * normal).sum(0), sh_radiance(gaussians.sh, towards)


def mean_light(light: torch.Tensor, rotations: torch.Tensor) -> torch.Tensor:
    """Return the mean in the world (H, W, 3) of a light map (H, W, 3) over rotations (V, 3, 3) from the world to its frame."""
    height, width = light.shape[:2]
    direction = texel_directions(height, width).to(light).view(-1, 3)
    return torch.stack([lookup(light, to_light_frame(direction, one)) for one in rotations]).mean(0).view_as(light).contiguous()
