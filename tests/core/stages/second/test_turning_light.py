# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that turns between the photographs, as on a turntable: the solver finds light and albedo, which it misses if it ignores the turns.

The photographs are computed with visibility in closed form in the frame of each photograph's light.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.kernels.lobes import TracedDirections
from irgspp.core.shading.environment_lookup import from_light_frame, to_light_frame
from irgspp.core.stages.second.solver.gaussian_materials import fitted_albedo
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples
from irgspp.core.stages.second.solver.radiance_transfer import RadianceTransfer
from sphere_on_floor import GLOW, TEXELS, blocked, known_materials, rendered, soft_light, solved, surface, transport, unit

VIEWS = 12


def turns():
    """Return rotations (V, 3, 3) of the light: a turntable whose axis leans a little."""
    angle = 2 * math.pi * np.arange(VIEWS) / VIEWS
    zero, c, s = 0 * angle, np.cos(angle), np.sin(angle)
    about = np.stack([c, -s, zero, s, c, zero, zero, zero, zero + 1], 1)
    lean = np.array([[1, 0, 0], [0, math.cos(0.1), -math.sin(0.1)], [0, math.sin(0.1), math.cos(0.1)]])
    return torch.from_numpy(lean @ about.reshape(-1, 3, 3) @ lean.T).float()


def still(position, normal, rotation):
    """Return the radiance transfer of points under one light, in its frame, with visibility in closed form."""
    known = transport(position, normal)
    direction, angle = known.traced[:2]
    local = to_light_frame(torch.from_numpy(normal), rotation).numpy()
    cosine = np.maximum(local @ direction, 0)
    world = from_light_frame(torch.from_numpy(direction.T.copy()), rotation).T.numpy()
    free = (cosine > 0) & ~blocked(position, normal, world)
    other = ((cosine > 0) & ~free)[:, None].astype(np.float32) * GLOW[:, None]
    weight = (cosine * angle / math.pi).astype(np.float32)
    rows = torch.from_numpy((weight * free).reshape(len(position), 4, TEXELS).sum(1))
    indirect = torch.from_numpy(np.einsum("pd,pcd->pc", weight, other).astype(np.float32))
    return RadianceTransfer(known.texels, TracedDirections(direction, angle, free.astype(np.float32), other), rows, indirect, True)


@pytest.fixture(scope="module")
def scene():
    """Radiance transfer with the turns, multi-view samples, and ground truth."""
    position, normal = surface(np.random.default_rng(0))
    rotations, random = turns(), np.random.default_rng(1)
    # The camera is fixed in the frame of the light, in front and above.
    cameras = from_light_frame(torch.tensor([[4.0, 0.0, 3.5]]).repeat(VIEWS, 1), rotations).numpy()
    toward = unit(cameras[None] - position[:, None])
    facing = np.einsum("pkc,pc->pk", toward, normal) > 0.2
    often = facing.sum(1) >= 3
    position, normal, toward, facing = position[often], normal[often], toward[often], facing[often]
    truth = (soft_light(), *known_materials(position))
    pairs = [(p, k) for p in range(len(position)) for k in random.permutation(np.flatnonzero(facing[p]))[:8]]
    point, image = np.array(sorted(pairs)).T
    view = torch.from_numpy(toward[point, image].astype(np.float32))
    dark, number = torch.zeros(len(point), 3), torch.from_numpy(image)
    places = (torch.from_numpy(position), torch.from_numpy(normal), torch.from_numpy(point))
    seen = MultiViewSamples(*places, view, dark, dark.bool(), number)
    colour = torch.zeros_like(dark)
    for k, rotation in enumerate(rotations):
        lit = replace(seen, normal=to_light_frame(seen.normal, rotation), view=to_light_frame(view, rotation))
        colour = torch.where((number == k)[:, None], rendered(lit, still(position, normal, rotation), *truth), colour)
    return replace(transport(position, normal), rotations=rotations), replace(seen, colour=colour), truth


def albedo_error(solver, truth):
    """Return the median relative error of the albedo, up to one factor per colour."""
    scale = (truth[1] / solver.albedo).median(0).values
    return float((solver.albedo * scale / truth[1] - 1).abs().median())


@pytest.fixture(scope="module")
def found(scene):
    transfer, seen, _ = scene
    return solved(seen, transfer)


def test_albedo_and_light_are_found_which_are_missed_without_the_turns(scene, found):
    transfer, seen, truth = scene
    ignored = solved(seen, replace(transfer, rotations=None))
    assert albedo_error(found, truth) < 0.025 and albedo_error(ignored, truth) > 5 * albedo_error(found, truth)
    differences = [float(((s.light / s.light.mean()).log() - (truth[0] / truth[0].mean()).log()).abs().median()) for s in (found, ignored)]
    assert differences[0] < 0.25 and differences[1] > 2 * differences[0]
    assert found.error() < 0.25 * ignored.error()


def test_albedo_is_fitted_under_the_light_of_each_photograph(scene):
    transfer, seen, truth = scene
    light, albedo, roughness, metallic = truth
    fits = [fitted_albedo(seen, one, light, roughness, metallic).albedo for one in (transfer, replace(transfer, rotations=None))]
    errors = [float((fit / albedo - 1).abs().median()) for fit in fits]
    assert errors[0] < 0.03 < errors[1]


def test_turns_by_nothing_change_nothing(scene):
    transfer, seen, truth = scene
    same, none = replace(transfer, rotations=torch.eye(3).repeat(VIEWS, 1, 1)), replace(transfer, rotations=None)
    rows = zip(same.rows(seen, truth[2]), none.rows(seen, truth[2]), strict=True)
    assert all(torch.allclose(one, other, rtol=1e-4, atol=1e-6) for one, other in rows)
    sums = [one.sums(seen, torch.tensor([0.2, 0.6]), truth[0]) for one in (same, none)]
    assert all(torch.allclose(one, other, rtol=1e-4, atol=1e-5) for one, other in zip(*sums, strict=True))
    one, other = (transfer.diffuse_rows(seen).irradiance(truth[0]) for transfer in (same, none))
    assert torch.allclose(one, other, rtol=1e-4, atol=1e-5)
