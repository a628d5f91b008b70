# SPDX-License-Identifier: GPL-3.0-or-later
"""A thin flat part under the object is its own; a table, a mat under several things and the foot of an object alone are not."""

from types import SimpleNamespace

import numpy as np
import pytest
from irgspp.core.capture.dense_points import DensePoints
from irgspp.core.capture.ground import find_ground, with_base
from irgspp.core.capture.object_region import find_object_region, lowest_height
from irgspp.core.capture.plane_texture import PlaneTexture
from irgspp.core.capture.segmentation import MIN_SUPPORT, _depth_seeds
from irgspp.core.capture.support_plane import SupportPlane
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import Bound
from irgspp.core.stereo.fusion import OrientedPoints

PIXEL, NOISE = 0.01, 0.17  # size of a depth map's pixel, and the noise of heights in pixels
PLANE = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0, NOISE * PIXEL, np.empty((0, 3)))
CAMERAS = [
    Camera(320, 240, 360.0, 360.0, 160.0, 120.0, look_at((3.4 * np.cos(a), 3.4 * np.sin(a), 1.8), (0, 0, 0.4)))
    for a in np.radians(range(0, 360, 60))
]


def column(x: float, y: float, radius: float = 0.3, top: float = 1.0) -> np.ndarray:
    """Points on the side of an upright column on the plane."""
    rng = np.random.default_rng(1)
    angle, height = rng.uniform(0, 2 * np.pi, 30000), rng.uniform(0, top, 30000)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), height], 1)


def ground_of(plate, things=((0.0, 0.0),)):
    """Ground of columns on a table; `plate` gives the height of its surface at x and y."""
    rng = np.random.default_rng(0)
    flat = rng.uniform(-2, 2, (300000, 2))
    around = np.min([np.hypot(flat[:, 0] - x, flat[:, 1] - y) for x, y in things], 0)
    flat = flat[around > 0.3]
    surface = np.column_stack([flat, plate(*flat.T)])
    points = np.concatenate([surface, *(column(x, y) for x, y in things)])
    points[:, 2] += NOISE * PIXEL * rng.normal(size=len(points))
    oriented = OrientedPoints(points, np.zeros_like(points), np.zeros_like(points), np.full(len(points), 3))
    dense = DensePoints([], [], oriented, np.array([0, 0, 0.4]), 3.7, PIXEL, True)
    region = find_object_region(dense, PLANE, CAMERAS)
    assert region is not None
    return dense, region, find_ground(dense, PLANE, region)


def disc(radius: float, pixels: float):
    return lambda x, y: np.where(np.hypot(x, y) < radius, pixels * PIXEL, 0.0)


@pytest.mark.parametrize("pixels", [1.0, 2.0])
def test_a_thin_plate_is_the_objects(pixels):
    dense, region, ground = ground_of(disc(0.8, pixels))
    assert ground.base is not None
    assert ground.base.height == pytest.approx(pixels * PIXEL, rel=0.1)
    height = pixels * PIXEL
    on_plate, beside_it, wall = [0.6, 0.0, height], [0.95, 0.0, 0.0], [0.3, 0.0, 0.5]
    assert ground.below(np.array([on_plate, beside_it, wall])).tolist() == [False, True, False]
    whole = with_base(region, dense, ground, None)
    assert whole.labels(np.array([[0.6, 0.0, height]]))[0] == 1
    assert whole.bound.radius > 0.8


def test_a_persons_sphere_limits_the_base():
    dense, region, ground = ground_of(disc(0.8, 1.0))
    sphere = Bound((0.0, 0.0, 0.4), 0.7)
    whole = with_base(region, dense, ground, sphere)
    assert whole.labels(np.array([[0.5, 0.0, PIXEL], [0.75, 0.0, PIXEL]])).tolist() == [1, 0]
    assert whole.bound == region.bound


def test_its_outline_is_found_within_a_cell():
    *_, ground = ground_of(disc(0.8, 2.0))
    assert ground.base is not None
    assert np.sqrt(ground.base.covered.sum() / np.pi) * 2 * PIXEL == pytest.approx(0.8, abs=2 * PIXEL)


def test_a_table_is_no_base():
    dense, _, ground = ground_of(disc(0.0, 0.0))
    assert ground.base is None
    assert ground.lowest == lowest_height(dense, PLANE)
    assert ground.below(np.array([[0.6, 0.0, 0.5 * ground.lowest], [0.6, 0.0, 1.5 * ground.lowest]])).tolist() == [True, False]


@pytest.mark.parametrize(
    ("name", "plate", "things"),
    [
        ("sheet of paper", disc(0.8, 0.3), ((0.0, 0.0),)),
        ("mat under two things", disc(1.4, 1.0), ((0.0, 0.0), (1.0, 0.0))),
        ("mat larger than what is looked at", disc(3.0, 1.0), ((0.0, 0.0),)),
        ("thin thing beside it", lambda x, y: np.where(np.hypot(x - 0.9, y) < 0.3, 2 * PIXEL, 0.0), ((0.0, 0.0),)),
    ],
)
def test_these_are_the_tables(name, plate, things):
    *_, ground = ground_of(plate, things)
    assert ground.base is None, name


def test_the_planes_texture_leaves_the_base_out():
    *_, ground = ground_of(disc(0.8, 2.0))
    frame = np.array([[0.1, 0, -1.5], [0, 0.1, -1.5], [0, 0, 0], [0, 0, 1]])
    seen = ground.visible(PlaneTexture(np.zeros((31, 31, 3), np.float32), np.ones((31, 31), np.float32), frame))
    assert seen.known[15, 8] == 0  # at x = -.7
    assert seen.known[15, 3] == 1  # at x = -1.2


def test_what_stands_on_the_plane_may_have_its_foot_low_above_it():
    _, region, ground = ground_of(disc(0, 0))
    low = 0.6 * ground.lowest
    foot, in_plane, wall, beside = [0.3, 0.0, low], [0.3, 0.0, 0.1 * low], [0.3, 0.0, 0.5], [0.8, 0.0, low]
    places = np.array([foot, in_plane, wall, beside])
    assert (region.near(places) & ground.may_be_foot(places)).tolist() == [True, False, False, False]


def test_depths_low_on_the_objects_foot_are_no_seed_for_the_table():
    _, region, ground = ground_of(disc(0, 0))
    for place, seed in (([0.3, 0.0, 0.6 * ground.lowest], 0), ([0.3, 0.0, 0.5], 1), ([0.8, 0.0, 0.6 * ground.lowest], -1)):
        same = SimpleNamespace(support=np.full((5, 5), MIN_SUPPORT), points=lambda place=place: np.tile(place, (5, 5, 1)))
        assert (_depth_seeds(same, region, ground) == seed).all()
