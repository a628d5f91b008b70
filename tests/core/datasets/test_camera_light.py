# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that moves with the camera is told from a light that stays."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.datasets.camera_light import MIN_CAMERA_LIGHT, hull_slope, radiance_slope, with_camera_light
from irgspp.core.errors import InputError
from irgspp.core.io.srgb import encode_srgb

POINTS, VIEWS = 400, 12


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def samples(radiance):
    """Samples (point, radiance, cosine) of a sphere, each seen from in front, of `radiance(normal, view)` (K,) times a random albedo."""
    random = np.random.default_rng(0)
    normal = unit(random.normal(size=(POINTS, 3))).repeat(VIEWS, 0)
    view = unit(normal + 0.8 * unit(random.normal(size=(POINTS * VIEWS, 3))))
    value = radiance(normal, view) * random.uniform(0.2, 0.8, POINTS).repeat(VIEWS)
    return np.arange(POINTS).repeat(VIEWS), value, cosine(normal, view)


def cosine(normal, view):
    return (normal * view).sum(-1)


def flash(normal, view):
    return cosine(normal, view).clip(0)


def room_with_flash(normal, view):
    return 0.5 + flash(normal, view)


def highlight(normal, view):
    """A gloss that mirrors one light above, over its diffuse part."""
    mirrored = 2 * cosine(normal, view)[..., None] * normal - view
    return 0.5 + 0.3 * normal[..., 2].clip(0) + 3 * mirrored[..., 2].clip(0) ** 20


def lamp_above(normal, view):
    return 1 + normal[..., 2]


def test_a_flash_brightens_what_faces_it_by_the_cosine():
    point, radiance, facing = samples(flash)
    mean = facing.reshape(POINTS, VIEWS).mean(1)
    assert radiance_slope(point, radiance, facing) == pytest.approx((1 / mean).mean(), rel=0.05)


@pytest.mark.parametrize(("light", "moves"), [(flash, True), (room_with_flash, True), (lamp_above, False), (highlight, False)])
def test_lights_are_told_on_the_surface(light, moves):
    slope = radiance_slope(*samples(light))
    assert slope > MIN_CAMERA_LIGHT if moves else abs(slope) < MIN_CAMERA_LIGHT / 2


def test_no_sample_tells_nothing():
    assert radiance_slope(np.zeros(0, int), np.zeros(0), np.zeros(0)) == 0


@pytest.fixture(scope="module")
def lit_sphere(camera_ring, sphere_dataset):
    """Function that returns the dataset of a unit sphere that shows `radiance(normal, view)`."""

    def lit(radiance):
        data = sphere_dataset(camera_ring(12))
        return replace(data, train=[replace(view, colour=shaded(view.camera, radiance)) for view in data.train])

    return lit


def shaded(camera, radiance):
    """Return the image (H, W, 3) of a unit sphere about the origin; grey beside it."""
    ray = unit(camera.rays().astype(np.float64))
    along = ray @ camera.centre
    root = along**2 - (camera.centre @ camera.centre - 1)
    normal = unit(camera.centre + (-along - np.sqrt(root.clip(0)))[..., None] * ray)
    return np.where(root[..., None] > 0, encode_srgb(0.5 * radiance(normal, -ray))[..., None], 0.5).astype(np.float32).repeat(3, -1)


@pytest.mark.parametrize(("light", "moves"), [(flash, True), (room_with_flash, True), (lamp_above, False)])
def test_masked_photographs_decide_whether_the_light_moves(lit_sphere, light, moves):
    data, warnings = lit_sphere(light), []
    train, test, found = with_camera_light(data.train[:10], data.train[10:], data.bound, "auto", warnings)
    assert len(train) == 10 and len(test) == 2 and len(warnings) == found == moves
    assert all((view.light_rotation is not None) == moves for view in (*train, *test))


def test_the_rotations_are_those_of_the_cameras(lit_sphere):
    data, warnings = lit_sphere(lamp_above), []
    train, test, found = with_camera_light(data.train[:10], data.train[10:], data.bound, "camera", warnings)
    assert found
    shone = [view.light_rotation @ view.camera.to_world[:3, :3] for view in (*train, *test)]  # the same in each camera's frame
    assert np.allclose(shone, shone[0]) and np.allclose(train[0].light_rotation, np.eye(3)) and not warnings


def test_the_setting_and_the_dataset_have_precedence(lit_sphere):
    data = lit_sphere(flash)
    assert all(view.light_rotation is None for view in with_camera_light(data.train, [], data.bound, "still", [])[0])
    stated = [replace(view, light_rotation=np.eye(3)) for view in data.train]
    assert all((view.light_rotation == np.eye(3)).all() for view in with_camera_light(stated, [], data.bound, "auto", [])[0])
    with pytest.raises(InputError, match=r"data\.light=camera: .* states how the light turns"):
        with_camera_light(stated, [], data.bound, "camera", [])


def test_where_nothing_can_be_seen_the_light_stays(lit_sphere):
    data = lit_sphere(flash)
    assert hull_slope([replace(view, alpha=None) for view in data.train], data.bound) == 0
    assert hull_slope([replace(view, colour=np.ones_like(view.colour)) for view in data.train], data.bound) == 0  # clipped
    contradicting = [replace(view, alpha=np.zeros_like(view.alpha) if i else view.alpha) for i, view in enumerate(data.train)]
    assert hull_slope(contradicting, data.bound) == 0
