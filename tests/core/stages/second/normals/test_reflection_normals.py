# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrong normals of a ball's brass cap turn towards its reflections; all others stay."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from irgspp.core.scene.surface import Surface
from irgspp.core.stages.second.normals import reflection_normals as module
from irgspp.core.stages.second.normals.reflection_normals import turn_to_reflections
from irgspp.core.surface.meshing import unit
from sphere_on_floor import photographed, soft_light, transport


@pytest.fixture
def ball(monkeypatch):
    """Return the true normals of a ball, a mesh of it whose normals are wrong by some 9 degrees, and a solver that knows the rest."""
    mesh = trimesh.creation.icosphere(3)
    true, random = np.asarray(mesh.vertices), np.random.default_rng(0)
    wrong = unit(true + 0.15 * np.sin(3 * true[:, [1, 2, 0]]) + 0.03 * random.normal(size=true.shape))

    def sample(position, normal, views, *rest, most):
        seen = photographed(transport(position, position), position, position)[0]
        return replace(seen, normal=torch.from_numpy(normal)), torch.arange(len(position))

    monkeypatch.setattr(module, "sample_views", sample)
    monkeypatch.setattr(module, "trace_radiance_transfer", lambda position, *rest, **options: transport(position.numpy(), position.numpy()))
    points = torch.from_numpy(true).float()
    solver = SimpleNamespace(
        samples=SimpleNamespace(position=points, normal=torch.from_numpy(wrong).float()),
        metallic=(points[:, 2] > 0.4).float(),
        roughness=torch.full((len(points),), 0.25),
        light=soft_light(),
        transfer=SimpleNamespace(texels=None, has_indirect=True),
    )
    return true, Surface(true, wrong, np.asarray(mesh.faces), 0.1), solver


def turned(surface, solver):
    tracer = SimpleNamespace(tree=None, offset=0.0, device="cpu")
    return turn_to_reflections(surface, solver, [], tracer, 0)


def angles(one, other):
    return np.degrees(np.arccos(np.clip((one * other).sum(1), -1, 1)))


def test_metal_turns_towards_its_reflections(ball):
    true, surface, solver = ball
    found = turned(surface, solver).normals
    cap = true[:, 2] > 0.5
    before, after = angles(surface.normals, true)[cap], angles(found, true)[cap]
    assert before.mean() > 5 and after.mean() < 0.5 * before.mean()
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)


def test_other_materials_keep_their_normals(ball):
    true, surface, solver = ball
    found = turned(surface, solver)
    rest = true[:, 2] < -0.1
    np.testing.assert_allclose(found.normals[rest], surface.normals[rest], atol=1e-12)
    assert found.vertices is surface.vertices and found.faces is surface.faces


def test_without_metal_the_surface_stays(ball):
    _, surface, solver = ball
    solver.metallic = torch.zeros_like(solver.metallic)
    assert turned(surface, solver) is surface


def test_batches_traced_anew_give_the_same_result(ball, monkeypatch):
    _, surface, solver = ball
    whole = turned(surface, solver).normals
    monkeypatch.setattr(module, "BATCH", 50)
    monkeypatch.setattr(module, "MAX_KEPT_VERTICES", 0)
    np.testing.assert_allclose(turned(surface, solver).normals, whole, atol=1e-6)
