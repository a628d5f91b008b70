# SPDX-License-Identifier: GPL-3.0-or-later
"""Initial Gaussians: the exact visual hull of a sphere is an intersection of cones."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.datasets.visual_hull import visual_hull
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import decode_srgb
from irgspp.core.scene.dataset import PointCloud
from irgspp.core.stages.first.initialization import (
    CAMERA_SIDE_COSINE,
    MAX_SURROUNDINGS_RADII,
    MIN_CAMERA_DISTANCES,
    initial_gaussians,
    observed_colour,
)


@pytest.fixture(scope="module")
def dataset(camera_ring, sphere_dataset):
    return sphere_dataset(camera_ring(12))


def cone_distance(points, cameras):
    """Return the signed distance to the nearest silhouette cone, negative inside the exact hull."""
    distances = []
    for camera in cameras:
        offset, axis = points - camera.centre, -camera.centre / np.linalg.norm(camera.centre)
        length = np.linalg.norm(offset, axis=1)
        angle = np.arccos(np.clip(offset @ axis / length, -1, 1))
        distances.append(length * np.sin(angle - np.arcsin(1 / np.linalg.norm(camera.centre))))
    return np.max(distances, 0)


def test_hull_holds_the_sphere_and_no_more_than_its_cones(dataset):
    hull = visual_hull(dataset.train, dataset.bound)
    inside, corner, step = hull.inside, hull.corner, hull.step
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in inside.shape), indexing="ij"), -1).reshape(-1, 3) * step + corner
    pixel = 5 / dataset.train[0].camera.fx  # at the far side
    sphere = np.linalg.norm(cells, axis=1) < 1 - pixel
    assert sphere.sum() > 10_000
    assert inside.reshape(-1)[sphere].min() > 0.99
    outside = cone_distance(cells, [v.camera for v in dataset.train]) > pixel
    assert outside.sum() > 10_000
    assert inside.reshape(-1)[outside].max() < 0.5


def test_start_lies_on_the_hull_and_faces_outward(dataset):
    g = initial_gaussians(dataset, 3000, np.random.default_rng(0))
    assert g.count == 3000
    points, normals = g.position.T.numpy(), g.normals().T.numpy()
    step = visual_hull(dataset.train, dataset.bound).step
    off = np.abs(cone_distance(points, [v.camera for v in dataset.train]))
    assert np.quantile(off, 0.99) < step
    outward = (normals * points).sum(1) / np.linalg.norm(points, axis=1)
    assert (outward > 0.6).mean() > 0.98
    shown = 0.5 + 0.28209479177387814 * g.sh[0].T.numpy()
    assert np.allclose(np.median(shown, 0), decode_srgb(np.array([0.8, 0.5, 0.2])), atol=1e-3)


def test_same_seed_same_start(dataset):
    first, second = (initial_gaussians(dataset, 100, np.random.default_rng(3)) for _ in range(2))
    assert all(a.equal(b) for a, b in zip(first.tensors().values(), second.tensors().values(), strict=True))


def test_masks_without_a_common_point_are_refused(dataset):
    views = [replace(v, alpha=np.zeros_like(v.alpha)) if i == 3 else v for i, v in enumerate(dataset.train)]
    with pytest.raises(InputError, match="no point"):
        visual_hull(views, dataset.bound)


def test_colour_comes_from_views_a_point_faces(dataset):
    up, away = np.array([[0, 0, 1.0]]), np.array([[0, 0, -1.0]])
    only_above = [v for v in dataset.train if v.camera.centre[2] > 2]
    assert np.allclose(observed_colour(only_above, up, up), decode_srgb(np.array([0.8, 0.5, 0.2])), atol=1e-5)
    assert np.allclose(observed_colour(only_above, up, away), decode_srgb(np.array(0.5)), atol=1e-5)


def test_without_masks_points_come_first_and_all_face_a_camera(camera_ring, sphere_dataset):
    cameras = camera_ring(6)
    rng = np.random.default_rng(1)
    known = rng.uniform(-1, 1, (50, 3)).astype(np.float32)
    dataset = sphere_dataset(cameras, masked=False, points=PointCloud(known, np.zeros_like(known)))
    g = initial_gaussians(dataset, 400, rng)
    points, normals = g.position.T.numpy(), g.normals().T.numpy()
    assert np.array_equal(points[:50], known)
    distance = np.linalg.norm(points[50:], axis=1)
    assert 120 < len(points) <= 200  # density control grows the other half
    clearance = 0.5 * min(np.linalg.norm(c.centre) for c in cameras)
    assert min(np.linalg.norm(points[50:] - c.centre, axis=1).min() for c in cameras) > clearance  # none close to a camera
    side = (points[50:] / distance[:, None]) @ np.stack([c.centre / np.linalg.norm(c.centre) for c in cameras]).T
    beside = side.max(1) > CAMERA_SIDE_COSINE
    away = np.median([np.linalg.norm(c.centre) for c in cameras])
    outer = distance > dataset.bound.radius
    assert (outer & beside).sum() > 20 and (outer & ~beside).sum() > 5
    assert distance[outer & beside].min() >= MIN_CAMERA_DISTANCES * away * (1 - 1e-6)  # none between cameras that look at the object
    assert distance[~beside].max() <= MAX_SURROUNDINGS_RADII * dataset.bound.radius
    assert 0.4 < (distance <= dataset.bound.radius).mean() < 0.9  # the object and its surroundings
    centres = np.stack([c.centre for c in cameras])
    nearest = centres[np.linalg.norm(points[:, None] - centres, axis=2).argmin(1)]
    facing = ((nearest - points) * normals).sum(1) / np.linalg.norm(nearest - points, axis=1)
    assert np.allclose(facing, 1, atol=1e-4)
    assert initial_gaussians(dataset, 20, rng).count == 20  # fewer than there are points
