# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts of a metal's refinement: the solver's result, or the first stage's light scaled to the brightness of the solver's.

The first stage's light has more detail, since sharp reflections show it. But that stage computes no visibility, and where reflections are
clipped in the photographs its radiance is too low. The solver's light is coarse, but its brightness is right: it comes from the rendering
equation, and a clipped value counts as a lower bound.

A solver that explains the photographs well (error below MAX_EXPLAINED_ERROR) gives the only start. Otherwise the two lights are combined.
Held-back views cannot decide between these cases: after refinement, they preferred the combination on all scenes.
"""

from __future__ import annotations

import torch

from ....scene.gaussians import ALBEDO, ROUGHNESS
from ....scene.reconstruction import Reconstruction
from ...common.light_map import resized_light
from ...common.nearest_neighbours import nearest_neighbours
from .gaussian_materials import LOGIT_MARGIN
from .light_material_solver import LightMaterialSolver

# Median error of the solver, in encoded values, below which its result is the start. It was .004 to .009 on three scenes, which gain 2 to
# 3 dB of albedo and 4 to 9 dB of light so, and .016 on teapot_glossy, which would lose 1 dB.
MAX_EXPLAINED_ERROR = 0.011
MIN_DIVISOR = 1e-4  # least mean radiance of a texel, and least albedo, by which is divided


def metal_starts(first: Reconstruction, solved: Reconstruction, solver: LightMaterialSolver) -> list[Reconstruction]:
    """Combine the solver's result for a metal with the first stage's.

    Args:
        first: result of the first stage, with reflections.
        solved: materials and light of the solver, assigned to the same Gaussians.
        solver: its light, its error, and the albedo of its points.

    Returns:
        `solved` alone where the solver's error is below MAX_EXPLAINED_ERROR; else two starts: with the albedo of the solver, and with that
        of the first stage. Both take metallic of the solver, roughness of the first stage, and its light with the levels of the solver's,
        of the rows of `solved`. Nothing tells a tint of the light from the metal's own colour: that of the first stage's light goes into
        the albedo, as the solver's light is about neutral.
    """
    if solver.error() < MAX_EXPLAINED_ERROR:
        return [solved]
    sharp = resized_light(first.environment, solved.environment.shape[0])
    rows = solver.transfer.texels.height  # of the large texels: the first stage knows better what is smaller
    light = levelled_light(sharp, area_means(solver.light_map(solver.transfer.texels.finest_height), rows))
    materials = solved.gaussians.material.clone()
    materials[ROUGHNESS] = first.gaussians.material.detach()[ROUGHNESS]
    own = materials.clone()
    albedo = first.gaussians.materials().detach()[ALBEDO] * albedo_ratio(first, solver)[:, None]
    own[ALBEDO] = torch.logit(albedo.clamp(LOGIT_MARGIN, 1 - LOGIT_MARGIN))
    return [first.relabelled(materials, light), first.relabelled(own, light)]


def albedo_ratio(first: Reconstruction, solver: LightMaterialSolver) -> torch.Tensor:
    """Return the median ratio (3,) of the solver's albedo to the first stage's: light and albedo are only known as a product."""
    g = first.gaussians
    albedo = g.materials().detach()[ALBEDO, nearest_neighbours(g.position.T, solver.samples.position, 1)[:, 0]].T
    return (solver.albedo / albedo.clamp_min(MIN_DIVISOR)).median(0).values


def levelled_light(detail: torch.Tensor, levels: torch.Tensor) -> torch.Tensor:
    """Scale a light map smoothly so that its means over the texels of a coarser one are about those of that one.

    Args:
        detail: (H, 2H, 3) linear radiance.
        levels: (h, 2h, 3) linear radiance, h <= H.

    Returns:
        (H, 2H, 3).
    """
    rows = levels.shape[0]
    return detail * resized_light(levels / area_means(detail, rows).clamp_min(MIN_DIVISOR), detail.shape[0])


def area_means(light: torch.Tensor, rows: int) -> torch.Tensor:
    """Return the means of a light map (H, 2H, 3) over the texels of a coarser one, (rows, 2 rows, 3)."""
    return torch.nn.functional.interpolate(light.permute(2, 0, 1)[None], size=(rows, 2 * rows), mode="area")[0].permute(1, 2, 0)
