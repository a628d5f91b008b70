# SPDX-License-Identifier: GPL-3.0-or-later
"""Points and normals of a fine surface along the normals of a coarse one."""

import numpy as np
import pytest
import trimesh
from irgspp.core.scene.surface import Surface
from irgspp.core.surface.nearest_hits import LIFT, NearestTracer


def ball(subdivisions: int, radius: float = 1.0) -> Surface:
    body = trimesh.creation.icosphere(subdivisions)
    return Surface(radius * body.vertices, np.array(body.vertices), np.array(body.faces), 0.01)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((a * b).sum(1), -1, 1)))


@pytest.mark.parametrize("radius", [0.96, 1.0, 1.03])
def test_normals_of_the_fine_surface_are_found_above_below_and_on_it(radius):
    turn = np.array([0.1, 0.0, 0.0])
    place, _ = ball(2, radius).samples(500, np.random.default_rng(0))
    radial = place / np.linalg.norm(place, axis=1, keepdims=True)
    tilted = (radial + turn) / np.linalg.norm(radial + turn, axis=1, keepdims=True)
    hits = NearestTracer(ball(5)).hits(place, radial)
    assert (hits.triangle >= 0).all() and hits.height == pytest.approx(1 - np.linalg.norm(place, axis=1), abs=2e-3)
    assert angles(NearestTracer(ball(5)).normals(place, tilted), radial).max() < 1.0  # a tilted ray meets it a little beside


def test_the_same_surface_is_met_everywhere():
    fine = ball(4)
    middle = fine.vertices[fine.faces].mean(1)
    for place in (middle, fine.vertices):
        normal = place / np.linalg.norm(place, axis=1, keepdims=True)
        hits = NearestTracer(fine).hits(place, normal)
        assert (hits.triangle >= 0).mean() > 0.999 and np.abs(hits.height[hits.triangle >= 0]).max() < 2 * LIFT * fine.voxel


def test_a_far_part_or_the_back_of_a_thin_one_keeps_the_own_normal():
    own = np.float32([[0, 0.6, 0.8]])
    tracer = NearestTracer(ball(4))
    assert tracer.normals(np.float32([[0, 0, 1.5]]), own).tolist() == own.tolist()
    assert tracer.normals(np.float32([[0, 0, 0.97]]), -own).tolist() == (-own).tolist()
