# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's model has the cameras, points and places that it is built from."""

import numpy as np
import pytest
from irgspp.core.capture.reconstruction import Tracks, build_reconstruction
from irgspp.core.scene.camera import Camera, look_at


def cameras() -> list[Camera]:
    eyes = [(3, 0, 1), (0, 3, 1), (-3, 0, 1), (0, -3, 1)]
    wide = [Camera(64, 48, 60.0, 61.0, 32.0, 24.0, look_at(eye)) for eye in eyes[:3]]
    return [*wide, Camera(48, 64, 60.0, 61.0, 24.0, 32.0, look_at(eyes[3]))]


def tracks(count: int = 20) -> Tracks:
    position = np.random.default_rng(0).normal(scale=0.3, size=(count, 3))
    pixel = np.concatenate([camera.project(position)[0] for camera in cameras()])
    point, photograph = np.tile(np.arange(count), 4), np.repeat(np.arange(4), count)
    colour = np.arange(3 * count, dtype=np.uint8).reshape(count, 3)
    return Tracks(position, colour, point.astype(np.int32), photograph.astype(np.int32), pixel)


def test_exact_places_have_no_error_and_equal_intrinsics_are_shared():
    model = build_reconstruction(["a", "b", "c", "d"], cameras(), tracks())
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() < 1e-5
    assert model.num_cameras() == 2 and [model.image(i + 1).name for i in range(4)] == ["a", "b", "c", "d"]
    assert model.num_points3D() == 20 and model.compute_num_observations() == 80
    assert model.image(4).cam_from_world().matrix() == pytest.approx(cameras()[3].world_to_cv[:3])


def test_points_are_selected_and_joined_with_their_places():
    whole = tracks()
    keep = np.arange(20) % 3 == 0
    parts = whole.select(keep), whole.select(~keep)
    assert parts[0].position == pytest.approx(whole.position[keep]) and len(parts[0].point) == 4 * keep.sum()
    joined = parts[0].joined(parts[1])
    for i, camera in enumerate(cameras()):
        own = joined.photograph == i
        assert joined.pixel[own] == pytest.approx(camera.project(joined.position[joined.point[own]])[0])
    assert sorted(map(tuple, joined.colour.tolist())) == sorted(map(tuple, whole.colour.tolist()))
