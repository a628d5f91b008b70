# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of the mesh from a camera, and their metrics."""

import numpy as np
import pytest
import trimesh
from irgspp.core.evaluation.ground_truth import Truth
from irgspp.core.evaluation.mesh_normals import mesh_normals
from irgspp.core.evaluation.protocols import PLAIN, PROTOCOLS
from irgspp.core.evaluation.view_metrics import mesh_metrics
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.mesh import Mesh

EYE = np.array([0.5, -2.5, 1.0])


@pytest.fixture(scope="module")
def seen():
    """Normals and coverage of a unit ball, and the exact ones."""
    ball = trimesh.creation.icosphere(5, 1.0)
    count = len(ball.vertices)
    points = ball.vertices.astype(np.float32)
    plain = np.zeros(count, np.float32)
    mesh = Mesh(
        points, points, np.zeros((count, 2), np.float32), ball.faces.astype(np.int32), np.zeros((count, 3), np.float32), plain, plain
    )
    camera = Camera(40, 30, 45.0, 45.0, 20.0, 15.0, look_at(EYE))
    ray = camera.rays() / np.linalg.norm(camera.rays(), axis=-1, keepdims=True)
    b, c = ray @ EYE, EYE @ EYE - 1
    hit = b * b > c
    exact = np.where(hit[..., None], EYE + (-b - np.sqrt(np.maximum(b * b - c, 0)))[..., None] * ray, 0)
    return mesh_normals(MeshQuery(mesh, 1.5), camera), exact, hit


def test_normals_are_those_of_the_surface_that_each_pixel_sees(seen):
    (normal, covered), exact, hit = seen
    assert (covered != hit).mean() < 0.01 and 0.1 < hit.mean() < 0.9
    both = hit & (covered > 0)
    assert (np.abs(normal - exact)[both] < 0.01).all() and (normal[covered == 0] == 0).all()


def test_metrics_of_the_mesh_have_names_of_their_own(seen):
    (normal, covered), exact, hit = seen
    truth = Truth(np.zeros((30, 40, 3)), hit.astype(np.float32), normal=exact, depth=hit.astype(np.float32))
    found = mesh_metrics(normal, covered, truth, PLAIN)
    assert set(found) == {"mesh_normal_mae", "mesh_normal_mae_full"} and found["mesh_normal_mae"] < 1.0
    turned = mesh_metrics(normal[..., [1, 2, 0]], covered, truth, PROTOCOLS["irgs"])
    assert turned["mesh_normal_mae"] > 30 and turned["mesh_normal_mae_full"] == pytest.approx(
        hit.mean() * turned["mesh_normal_mae"], rel=0.1
    )
