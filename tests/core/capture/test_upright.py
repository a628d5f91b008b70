# SPDX-License-Identifier: GPL-3.0-or-later
"""World frame of a capture: known poses after an arbitrary similarity come back."""

import numpy as np
import pytest
from irgspp.core.capture.upright import is_wall, world_similarity
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound
from scipy.spatial.transform import Rotation

CENTRE, RADIUS = np.array([0.3, -0.2, 0.25]), 0.25


def true_cameras():
    angles = np.radians(-90 + np.arange(0, 360, 40))  # the first is in front, at -Y of the object
    eyes = [CENTRE + 1.5 * np.array([np.cos(a), np.sin(a), 0.5]) for a in angles]
    return [Camera(64, 48, 60, 60, 32, 24, look_at(eye, CENTRE)) for eye in eyes]


def model_frame(seed):
    """Return an arbitrary similarity (4, 4) from the true world to the frame of a solver."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = 2.7 * Rotation.random(random_state=seed).as_matrix()
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


@pytest.mark.parametrize("seed", range(4))
def test_object_stands_on_the_ground_and_faces_the_front(seed):
    away = model_frame(seed)
    normal = away[:3, :3] @ [0, 0, 1] / 2.7
    offset = normal @ (away @ [0, 0, 0, 1])[:3]  # the plane Z = 0
    bound = Bound(tuple((away @ [*CENTRE, 1])[:3]), 2.7 * RADIUS)
    similarity = world_similarity([c.moved(away) for c in true_cameras()], bound, (normal, offset), 1 / 2.7)
    expected = np.eye(4)
    expected[:2, 3] = -CENTRE[:2]  # the object ends up above the origin
    np.testing.assert_allclose(similarity @ away, expected, atol=1e-9)


def test_without_plane_the_cameras_tell_up():
    away = model_frame(5)
    bound = Bound(tuple((away @ [*CENTRE, 1])[:3]), 2.7 * RADIUS)
    similarity = world_similarity([c.moved(away) for c in true_cameras()], bound, None, None) @ away
    np.testing.assert_allclose((similarity @ [*CENTRE, 1])[:3], 0, atol=1e-9)
    up = similarity[:3, :3] @ [0, 0, 1]
    assert up[2] / np.linalg.norm(up) > 0.999
    assert np.cbrt(np.linalg.det(similarity[:3, :3])) == pytest.approx(1 / RADIUS)  # the object's radius becomes 1


def test_a_camera_straight_above_leaves_the_heading():
    camera = Camera(64, 48, 60, 60, 32, 24, look_at((0, 0, 2), (0, 0, 0)))
    similarity = world_similarity([camera] * 3, Bound((0, 0, 0), 0.5), (np.array([0, 0, 1.0]), 0.0), None)
    np.testing.assert_allclose(similarity, np.diag([2, 2, 2, 1]), atol=1e-12)


def test_a_wall_is_told_from_a_table():
    around = [Camera(8, 8, 8.0, 8.0, 4.0, 4.0, look_at((3 * np.cos(a), 3 * np.sin(a), 1.5))) for a in np.linspace(0, 5, 9)]
    assert not is_wall(around, np.array([0.0, 0.0, 1.0]))
    assert is_wall(around, np.array([0.0, -1.0, 0.0]))
    steep = [Camera(8, 8, 8.0, 8.0, 4.0, 4.0, look_at((np.cos(a), np.sin(a), 2.5))) for a in np.linspace(0, 1, 5)]  # from one side
    assert not is_wall(steep, np.array([0.0, 0.0, 1.0]))
