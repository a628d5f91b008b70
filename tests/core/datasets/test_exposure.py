# SPDX-License-Identifier: GPL-3.0-or-later
"""Exposure gains against known ones, on views of coloured points."""

import numpy as np
import pytest
from irgspp.core.datasets.exposure import EXPLAINED, estimate_log_gains, even_exposures, point_colours, shrunk, unexplained
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.dataset import PointCloud, View

SIZE, COUNT = 48, 10


def scene(gains, gloss=0.0, seed=0):
    """Return views of points on a sphere, each a disc of its colour times the view's gain, and the points."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(150, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    albedo = rng.uniform(0.15, 0.5, (150, 3))
    views = []
    for i, gain in enumerate(gains):
        angle = 2 * np.pi * i / len(gains)
        camera = Camera(SIZE, SIZE, 50, 50, SIZE / 2, SIZE / 2, look_at((4 * np.cos(angle), 4 * np.sin(angle), 1)))
        pixel, depth = camera.project(points)
        linear = np.full((SIZE, SIZE, 3), 0.2) * gain
        for j in np.argsort(-depth):
            column, row = np.floor(pixel[j]).astype(int)
            shine = gloss * rng.random() ** 8
            linear[row - 1 : row + 2, column - 1 : column + 2] = (albedo[j] + shine) * gain
        views.append(View(f"{i}", camera, None, encode_srgb(linear).astype(np.float32), None))
    return views, PointCloud(points.astype(np.float32), albedo.astype(np.float32))


def random_gains(seed=1, spread=0.3):
    logs = np.random.default_rng(seed).normal(scale=spread, size=(COUNT, 1)) + np.random.default_rng(seed + 1).normal(
        scale=0.08, size=(COUNT, 3)
    )
    return np.exp(logs - logs.mean(0))


@pytest.mark.parametrize("gloss", [0.0, 0.3])
def test_gains_are_found(gloss):
    gains = random_gains()
    views, points = scene(gains, gloss)
    found = estimate_log_gains(point_colours(views, points))
    assert np.abs(found.mean(0)).max() < 1e-9
    error = np.abs(found - np.log(gains))
    assert error.max() < (0.05 if gloss == 0 else 0.12)  # hidden points show the colours of those before them


def test_photographs_that_show_too_few_points_keep_the_mean_gain():
    views, points = scene(random_gains())
    logs = point_colours(views, points)
    logs[3, 5:] = np.nan
    found = estimate_log_gains(logs)
    others = np.delete(found, 3, 0)
    np.testing.assert_allclose(found[3], others.mean(0), atol=1e-9)


def test_dark_and_clipped_pixels_and_those_outside_the_mask_do_not_count():
    views, points = scene(np.ones((3, 3)))
    views[0].colour[:] = 0.01
    views[1].colour[..., 2] = 1.0
    masked = View("2", views[2].camera, None, views[2].colour, np.zeros((SIZE, SIZE), np.float32))
    logs = point_colours([views[0], views[1], masked], points)
    assert np.isnan(logs).all()
    assert np.isfinite(point_colours([views[2]], points)).all(-1).sum() == 150


def test_seen_points_alone_count():
    views, points = scene(np.ones((3, 3)))
    seen = np.zeros((3, 150), bool)
    seen[1, 7] = True
    logs = point_colours(views, points, seen)
    assert np.isfinite(logs[..., 0]).sum() == 1 and np.isfinite(logs[1, 7]).all()


def test_noise_is_removed_and_metadata_trusted():
    rng = np.random.default_rng(0)
    noise = rng.normal(scale=0.05, size=(40, 3))
    assert np.abs(shrunk(noise)).max() == 0  # smaller than gloss alone causes
    expected = rng.normal(scale=0.4, size=40)
    np.testing.assert_allclose(shrunk(noise + expected[:, None], expected).mean(1), expected - expected.mean(), atol=1e-12)
    true = rng.normal(scale=0.6, size=40)
    kept = shrunk(np.repeat(true[:, None], 3, 1) + noise, np.zeros(40)).mean(1)
    assert np.corrcoef(kept, true)[0, 1] > 0.99 and kept.std() > 0.9 * true.std()


def test_photographs_are_evened_out():
    gains = random_gains(spread=0.5)
    views, points = scene(gains)
    lines = []
    even = even_exposures(views, points, "auto", lines)
    border = np.stack([decode_srgb(view.colour[0, 0]) for view in even])
    before = np.stack([decode_srgb(view.colour[0, 0]) for view in views])
    assert np.log(border).std(0).max() < 0.12 < 0.3 < np.log(before).std(0).min()
    assert len(lines) == 1 and "data.exposure" in lines[0]
    assert even_exposures(views, points, "off", lines)[0] is views[0]
    assert even_exposures(views, None, "auto", lines)[0] is views[0]
    assert len(lines) == 1


def test_stated_gains_have_precedence():
    from dataclasses import replace

    views, points = scene(np.ones((4, 3)))
    stated = [replace(view, gain=np.array([1.0 + i, 1, 1])) for i, view in enumerate(views)]
    even = even_exposures(stated, points, "auto", [])
    for i in range(4):
        expected = decode_srgb(views[i].colour) / np.array([1.0 + i, 1, 1])
        np.testing.assert_allclose(decode_srgb(even[i].colour), expected, rtol=1e-4, atol=1e-6)


def test_shading_of_a_turning_light_is_not_taken_for_exposure():
    from dataclasses import replace

    views, points = scene(random_gains(spread=0.5))
    turning = [replace(view, light_rotation=np.eye(3)) for view in views]
    assert even_exposures(turning, points, "auto", [])[0] is turning[0]
    assert even_exposures(turning, points, "on", [])[0] is not turning[0]


def test_equal_exposures_change_nothing():
    views, points = scene(np.ones((6, 3)))
    lines = []
    even = even_exposures(views, points, "auto", lines)
    assert all(a is b for a, b in zip(even, views, strict=True)) and not lines


def test_mirrors_are_not_taken_for_exposure():
    rng = np.random.default_rng(4)
    logs = np.log(rng.uniform(0.1, 0.6, (COUNT, 1, 1)) * rng.uniform(0.1, 1, (COUNT, 300, 3)))  # every view shows other reflections
    exposed = np.log(rng.uniform(0.1, 0.6, (1, 300, 3)) * np.exp(0.1 * rng.normal(size=(COUNT, 300, 3)))) + np.log(random_gains())[:, None]
    assert unexplained(exposed) < 0.75
    reflections = logs - logs.mean((1, 2), keepdims=True)
    assert unexplained(reflections) > EXPLAINED
