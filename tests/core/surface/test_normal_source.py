# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the normals of a mesh come from."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from irgspp.core.scene.surface import Surface
from irgspp.core.surface.material_fusion import FusedMaterials
from irgspp.core.surface.normal_source import NormalSource, resolves

UP, TILTED = np.float32([[0, 0, 1]]), np.float32([[0.6, 0, 0.8]])


def plane(normal: np.ndarray) -> Surface:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
    return Surface(corners, np.repeat(normal.astype(np.float64), 4, 0), np.array([[0, 1, 2], [0, 2, 3]]), 0.1)


def fused(normal: np.ndarray, count: int, seen: float = 1.0) -> FusedMaterials:
    half = np.full(count, 0.5, np.float32)
    return FusedMaterials(np.repeat(normal, count, 0), np.repeat(half[:, None], 3, 1), half, half, np.full(count, seen, np.float32))


@pytest.fixture
def points() -> np.ndarray:
    return np.concatenate([np.random.default_rng(0).uniform(-0.9, 0.9, (50, 2)), np.zeros((50, 1))], 1).astype(np.float32)


def test_a_fine_surface_gives_the_normals(points):
    found = NormalSource(1.0, plane(TILTED), resolved=True).normals(points, np.repeat(UP, 50, 0), fused(UP, 50))
    np.testing.assert_allclose(found, np.repeat(TILTED, 50, 0), atol=1e-6)


def test_without_one_the_views_give_what_exceeds_the_noise(points):
    mesh = np.repeat(UP, 50, 0)
    np.testing.assert_allclose(NormalSource(1.0, noise=0.0).normals(points, mesh, fused(TILTED, 50)), np.repeat(TILTED, 50, 0), atol=1e-6)
    for source in (NormalSource(0.0), NormalSource(1.0)):  # no detail; all of it is noise, as half of the points differ by as much
        np.testing.assert_allclose(source.normals(points, mesh, fused(TILTED, 50)), mesh, atol=1e-6)
    np.testing.assert_array_equal(NormalSource(1.0, noise=0.0).normals(points, mesh, fused(TILTED, 50, seen=0.0)), mesh)


def test_a_coarse_surface_takes_detail_from_the_views(points):
    found = NormalSource(1.0, plane(UP), resolved=False, noise=0.0).normals(points, np.repeat(TILTED, 50, 0), fused(TILTED, 50))
    np.testing.assert_allclose(found, np.repeat(TILTED, 50, 0), atol=1e-6)


def test_short_edges_resolve_the_pixels(camera_ring):
    body = trimesh.creation.icosphere(4)  # edges of 0.07
    surface = Surface(np.array(body.vertices), np.array(body.vertices), np.array(body.faces), 0.1)
    few, many = ([replace(camera, fx=focal, fy=focal) for camera in camera_ring(4)] for focal in (60.0, 600.0))
    assert resolves(surface, few) and not resolves(surface, many)
