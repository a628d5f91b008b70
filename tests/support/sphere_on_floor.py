# SPDX-License-Identifier: GPL-3.0-or-later
"""Sphere on a floor with materials, light and visibility in closed form, and multi-view samples computed by the model's own equations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from irgspp.core.kernels.lobes import TracedDirections
from irgspp.core.shading.environment_lookup import texel_directions
from irgspp.core.shading.specular_albedo import diffuse_fraction
from irgspp.core.stages.second.solver.light_material_solver import LightMaterialSolver
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples
from irgspp.core.stages.second.solver.radiance_transfer import RadianceTransfer
from irgspp.core.stages.second.solver.solver_run import run_solver

HEIGHT = 8
TEXELS = 2 * HEIGHT**2
FLOOR, FLOOR_RADIUS = -1.0, 3.0
GLOW = np.array([0.15, 0.12, 0.1], np.float32)  # radiance of occluders


def unit(rows):
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)


def surface(random, on_sphere=300, on_floor=150):
    """Return positions and normals (P, 3) on the floor and the sphere's upper part, as all cameras are above."""
    sphere = unit(random.normal(size=(on_sphere, 3)))
    sphere = sphere[sphere[:, 2] > -0.7]
    floor = np.concatenate([random.uniform(-2, 2, (on_floor, 2)), np.full((on_floor, 1), FLOOR)], 1)
    normal = np.concatenate([sphere, np.tile([0.0, 0.0, 1.0], (on_floor, 1))])
    return np.concatenate([sphere, floor]).astype(np.float32), normal.astype(np.float32)


def blocked(position, normal, direction):
    """Return the mask (P, D) of directions that are blocked by the sphere or the floor."""
    start = position + 1e-3 * normal
    along = start @ direction
    sphere = (along < 0) & (along**2 > (start**2).sum(1)[:, None] - 1)
    down = np.where(direction[2] < -1e-6, direction[2], np.nan)
    distance = (FLOOR - start[:, 2:]) / down
    where = start[:, None, :2] + distance[..., None] * direction[:2].T
    return sphere | ((distance > 0) & ((where**2).sum(-1) < FLOOR_RADIUS**2))


def transport(position, normal, texels=LightTexels.uniform(HEIGHT), side=2):  # noqa: B008  # it does not change
    """Return the radiance transfer of the points."""
    direction, angle = texels.directions(side, 0)
    cosine = np.maximum(normal @ direction, 0)
    free = (cosine > 0) & ~blocked(position, normal, direction)
    visible = free.astype(np.float32)
    other = ((cosine > 0) & ~free)[:, None].astype(np.float32) * GLOW[:, None]
    weight = cosine * angle / math.pi
    irradiance = torch.from_numpy((weight * visible).reshape(len(position), side**2, texels.count).sum(1))
    return RadianceTransfer(
        texels,
        TracedDirections(direction, angle, visible, other),
        irradiance,
        torch.from_numpy(np.einsum("pd,pcd->pc", weight, other)),
        True,
    )


def soft_light():
    """Return an environment map (T, 3) of a sky with lamps of several sizes and colours."""
    light = torch.full((TEXELS, 3), 0.25)
    direction = texel_directions(HEIGHT, 2 * HEIGHT).reshape(-1, 3)
    lamps = (
        ((1, 0.5, 0.8), (8, 6, 4), 12),
        ((-1, 0.2, 0.3), (1, 2, 4), 6),
        ((0, -1, 0.6), (3, 3, 2), 20),
        ((0.3, 0.9, -0.3), (1, 0.5, 0.5), 4),
    )
    for axis, colour, sharpness in lamps:
        towards = torch.from_numpy(unit(np.array(axis, float))).float()
        light += (direction @ towards).clamp_min(0)[:, None] ** sharpness * torch.tensor(colour)
    return light


def known_materials(position):
    """Return albedo (P, 3), roughness and metallic (P,) of a sphere, half red and half blue with a brass cap, on a grey floor."""
    floor, cap = position[:, 2] == FLOOR, position[:, 2] > 0.4
    albedo = np.where(position[:, :1] > 0, [0.7, 0.2, 0.15], [0.2, 0.35, 0.6])
    albedo = np.where(cap[:, None], [0.9, 0.7, 0.4], np.where(floor[:, None], 0.5, albedo))
    roughness = np.where(cap, 0.25, np.where(floor, 0.7, 0.4))
    return tuple(torch.from_numpy(np.asarray(a, np.float32)) for a in (albedo, roughness, cap))


def photographed(transfer, position, normal, views=8):
    """Return multi-view samples computed by the model, and the ground truth: light, albedo, roughness, metallic."""
    random = np.random.default_rng(1)
    cameras = unit(random.normal(size=(40, 3)))
    toward = unit(5 * cameras * [1, 1, 0] + 5 * np.abs(cameras) * [0, 0, 1] - position[:, None])
    facing = np.einsum("pkc,pc->pk", toward, normal) > 0.2
    pairs = [(p, k) for p in range(len(position)) for k in random.permutation(np.flatnonzero(facing[p]))[:views]]
    point, camera = np.array(pairs).T
    view = torch.from_numpy(toward[point, camera].astype(np.float32))
    dark = torch.zeros(len(point), 3)
    seen = MultiViewSamples(torch.from_numpy(position), torch.from_numpy(normal), torch.from_numpy(point.copy()), view, dark, dark.bool())
    truth = (soft_light(), *known_materials(position))
    return replace(seen, colour=rendered(seen, transfer, *truth)), truth


def rendered(seen, transfer, light, albedo, roughness, metallic):
    """Return the radiance (K, 3) of the samples."""
    point = seen.point
    f0_term, fresnel_term, f0_indirect, fresnel_indirect = transfer.rows(seen, roughness)
    irradiance = (transfer.irradiance @ light + transfer.indirect)[point]
    fraction = diffuse_fraction((seen.normal[point] * seen.view).sum(1), roughness[point])[:, None]
    metal = metallic[point, None]
    specular = f0_term @ light + f0_indirect
    f0 = 0.04 * (1 - metal) + metal * albedo[point]
    return (1 - metal) * albedo[point] * fraction * irradiance + f0 * specular + fresnel_term @ light + fresnel_indirect


def make(*counts):
    """Return radiance transfer, multi-view samples and ground truth; `counts` as for `surface`."""
    position, normal = surface(np.random.default_rng(0), *counts)
    transfer = transport(position, normal)
    return transfer, *photographed(transfer, position, normal)


def start(seen, transfer, seed=0):
    """Return a light-material solver at its initial state."""
    count = len(seen.position)
    return LightMaterialSolver(seen, transfer, torch.full((count,), 0.5), torch.zeros(count), seed)


def solved(seen, transfer, seed=0):
    """Return a light-material solver that has run to its end."""
    return run_solver(start(seen, transfer, seed))
