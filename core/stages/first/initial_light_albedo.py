# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial light and albedo: the Gaussians' diffuse radiance is explained by a distant light first and by albedo second.

Shadows and inter-reflections are neglected. The second stage models both and starts from roughness and metallic alone; on metal it also
tries this light and albedo as a start. The light comes first because an albedo that starts from the radiance itself is a local minimum
that no regulariser leaves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from ...rendering.turning_light import most_facing_radiance
from ...scene.dataset import View, light_rotations
from ...scene.gaussians import ALBEDO, METALLIC
from ...scene.reconstruction import Reconstruction
from ...scene.spherical_harmonics import sh_radiance
from ...shading.environment_lookup import lookup
from ...shading.split_sum import diffuse_light
from ..common.adam import Adam
from ..common.light_map import resampled_light
from ..common.nearest_neighbours import nearest_neighbours

LIGHT_HEIGHT = 16  # rows of the fitted light map
STEPS = 200  # of Adam: half of them fit the light under a constant albedo, the others both
MAX_FITTED_GAUSSIANS = 8000  # Gaussians that the light is fitted to, at most
ALBEDO_RANGE = (0.03, 0.97)  # of the diffuse albedo that follows from the light
SMOOTHNESS = 0.02  # weight of the difference of log albedo between neighbours of similar colour
LIGHT_PRIOR = 1e-3  # weight of the squared difference of the log light from its mean
LIGHT_RATE, ALBEDO_RATE, FINAL_RATE_FACTOR = 0.1, 0.05, 0.1  # learning rates of the logarithms, and factor of both at the end


def estimate_light_albedo(reconstruction: Reconstruction, seed: int, views: Sequence[View] = ()) -> Reconstruction:
    """Estimate the albedo, and the light unless reflections have determined it, from the diffuse radiance.

    The overall scale between light and albedo is ambiguous: a fitted light is scaled so that the median albedo is 0.5.

    Args:
        reconstruction: result of the first stage, on the CPU; its light is kept where it has split-sum reflections. It is modified.
        seed: seed of the random selection of Gaussians that the light is fitted to.
        views: training views. Where the light turns between them, each surfel is taken as the camera that it faces most shows it.

    Returns:
        The same reconstruction; unchanged where no surfel is opaque.
    """
    g = reconstruction.gaussians
    # Initial normals face outward, and training turns them by less than 90 degrees.
    if light_rotations(views) is not None:
        seen, normal = most_facing_radiance(g, views)
    else:
        seen, normal = sh_radiance(g.sh, g.normals()).T, g.normals().T
    diffuse_weight = 1 - g.materials()[METALLIC]
    solid = torch.nonzero(g.opacity.sigmoid() > 0.5)[:, 0]
    if not len(solid):
        return reconstruction
    pick = solid[torch.randperm(len(solid), generator=torch.Generator().manual_seed(seed))[:MAX_FITTED_GAUSSIANS]]
    if not reconstruction.has_split_sum:
        light = _fit_light(normal[pick], seen[pick], g.position.T[pick])
        reconstruction.environment = resampled_light(light, reconstruction.environment.shape[0])
    irradiance = lookup(diffuse_light(reconstruction.environment), normal).clamp_min(1e-4)
    body = (seen / irradiance).clamp(*ALBEDO_RANGE)
    metal = g.materials()[ALBEDO].T
    albedo = diffuse_weight[:, None] * body + (1 - diffuse_weight[:, None]) * metal
    g.material[ALBEDO] = torch.logit(albedo.clamp(1e-3, 1 - 1e-3)).T
    return reconstruction


def _fit_light(normal: torch.Tensor, seen: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
    """Fit a (16, 32, 3) light to radiance `seen` (N, 3): with constant albedo first, then jointly with a smooth albedo."""
    neighbours = nearest_neighbours(position, position, 5)[:, 1:]
    similarity = torch.exp(-10 * (seen[:, None] - seen[neighbours]).abs().sum(-1))
    log_light = torch.full((LIGHT_HEIGHT, 2 * LIGHT_HEIGHT, 3), math.log(2 * float(seen.mean()) + 1e-3), requires_grad=True)
    log_albedo = torch.full_like(seen, math.log(0.5)).requires_grad_()
    adam = Adam([{"params": [log_light], "lr": LIGHT_RATE}, {"params": [log_albedo], "lr": 0.0}], fused=True)
    for step in range(STEPS):
        adam.param_groups[0]["lr"] = LIGHT_RATE * FINAL_RATE_FACTOR ** (step / STEPS)
        adam.param_groups[1]["lr"] = 0.0 if step < STEPS // 2 else ALBEDO_RATE * FINAL_RATE_FACTOR ** (step / STEPS)
        albedo = log_albedo.exp()
        predicted = albedo * lookup(diffuse_light(log_light.exp()), normal)
        # gather, not [neighbours]: the gradient of indexing is summed in an order that depends on the threads.
        around = log_albedo.gather(0, neighbours.reshape(-1, 1).expand(-1, 3)).view(*neighbours.shape, 3)
        jumps = (log_albedo[:, None] - around).abs().sum(-1)
        prior = LIGHT_PRIOR * (log_light - log_light.detach().mean((0, 1))).square().mean()
        loss = (predicted.clamp_min(1e-4).sqrt() - seen.clamp_min(1e-4).sqrt()).abs().mean() + prior
        loss = loss + SMOOTHNESS * (similarity * jumps).mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    scale = (log_albedo.exp().median() / 0.5).detach()
    return log_light.detach().exp() * scale
