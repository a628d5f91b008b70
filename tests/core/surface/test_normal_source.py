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


def test_a_coarse_surface_is_averaged_with_the_views(points):
    mean = (UP + TILTED) / np.linalg.norm(UP + TILTED)
    source = NormalSource(1.0, plane(UP), resolved=False)
    np.testing.assert_allclose(source.normals(points, np.repeat(TILTED, 50, 0), fused(TILTED, 50)), np.repeat(mean, 50, 0), atol=1e-6)


def test_without_one_the_mesh_is_averaged_with_the_views_twice(points):
    """At the vertices, and at the texels between them."""
    once = NormalSource(1.0).normals(points, np.repeat(UP, 50, 0), fused(TILTED, 50))
    twice = NormalSource(1.0).normals(points, once, fused(TILTED, 50))
    mean = (UP + TILTED) / np.linalg.norm(UP + TILTED)
    assert np.degrees(np.arccos((twice * mean).sum(1))).max() < 1.5
    unseen = NormalSource(1.0).normals(points, once, fused(TILTED, 50, seen=0.0))
    np.testing.assert_allclose(unseen, once, atol=1e-6)
    np.testing.assert_allclose(NormalSource(0.0).normals(points, once, fused(TILTED, 50)), once, atol=1e-6)


def test_short_edges_resolve_the_pixels(camera_ring):
    body = trimesh.creation.icosphere(4)  # edges of 0.07
    surface = Surface(np.array(body.vertices), np.array(body.vertices), np.array(body.faces), 0.1)
    few, many = ([replace(camera, fx=focal, fy=focal) for camera in camera_ring(4)] for focal in (60.0, 600.0))
    assert resolves(surface, few) and not resolves(surface, many)
