# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of a surface follow those of the solver's points of metal."""

from types import SimpleNamespace

import numpy as np
import torch
import trimesh
from irgspp.core.scene.surface import Surface
from irgspp.core.stages.second.normals.normal_improvement import turned_metal
from irgspp.core.surface.meshing import unit


def test_a_surface_turns_where_its_points_of_metal_turned():
    ball = trimesh.creation.icosphere(3)
    vertices = np.asarray(ball.vertices)
    surface = Surface(vertices, vertices, np.asarray(ball.faces), 0.1)
    position = unit(np.random.default_rng(0).normal(size=(500, 3)))
    metal = position[:, 2] > 0.3
    turned = unit(position + np.where(metal[:, None], 0.1 * np.cross(position, [1.0, 0.0, 0.0]), 0))
    tensors = [torch.from_numpy(values).float() for values in (position, turned)]
    solver = SimpleNamespace(samples=SimpleNamespace(position=tensors[0], normal=tensors[1]), surface_normal=tensors[0])
    found = turned_metal(surface, solver).normals
    inside, outside = vertices[:, 2] > 0.5, vertices[:, 2] < -0.2
    wanted = unit(vertices + 0.1 * np.cross(vertices, [1.0, 0.0, 0.0]))
    assert np.abs(found - wanted)[inside].max() < 0.02
    np.testing.assert_allclose(found[outside], vertices[outside], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
