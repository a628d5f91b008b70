# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps of analytic scenes: accuracy, masks, bounds, first depths, determinism, progress."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent
from irgspp.core.stereo.estimation import estimate_depth_maps
from irgspp.core.stereo.settings import StereoSettings

NEAREST, FARTHEST = 2.5, 5.5


def estimated(scene, nearest=NEAREST, farthest=FARTHEST, points=None, settings=StereoSettings(), seed=1, progress=Silent(), initial=None):  # noqa: B008
    bounds = [b if isinstance(b, list) else [b] * len(scene.views) for b in (nearest, farthest)]
    return estimate_depth_maps(scene.views, *bounds, points, settings, seed, progress, initial)


@pytest.fixture(scope="module")
def sphere_maps(sphere):
    return estimated(sphere)


def errors(scene, maps, least=2):
    """Relative depth errors and normal errors in degrees of supported pixels on the solid, and the fraction that these are of it."""
    depth, normal, kept = [], [], []
    for one, true, direction in zip(maps, scene.depth, scene.normal, strict=True):
        good = (one.support >= least) & (true > 0)
        kept.append(good.sum() / (true > 0).sum())
        depth.append(np.abs(one.depth[good] - true[good]) / true[good])
        normal.append(np.degrees(np.arccos(np.clip((one.normal[good] * direction[good]).sum(-1), -1, 1))))
    return np.concatenate(depth), np.concatenate(normal), np.mean(kept)


@pytest.mark.parametrize("name", ["sphere", "plane"])
def test_depth_and_normals_are_found(name, request):
    scene = request.getfixturevalue(name)
    depth, normal, kept = errors(scene, request.getfixturevalue("sphere_maps") if name == "sphere" else estimated(scene))
    assert kept > 0.6
    assert np.median(depth) < 0.006 and (depth < 0.02).mean() > 0.9  # 0.006 is a tenth of a pixel between neighbouring views
    assert np.median(normal) < 10


def test_brightness_tells_depth_without_texture(shaded_sphere):
    """Shading looks alike at many depths when its brightness does not count."""
    depth, _, kept = errors(shaded_sphere, estimated(shaded_sphere))
    without, _, _ = errors(shaded_sphere, estimated(shaded_sphere, settings=StereoSettings(brightness=0.0)))
    assert kept > 0.5
    assert np.median(depth) < 0.6 * np.median(without)


def test_maps_have_the_form_that_they_promise(sphere, sphere_maps):
    for one, view in zip(sphere_maps, sphere.views, strict=True):
        found = one.depth > 0
        assert one.depth.dtype == one.normal.dtype == one.cost.dtype == np.float32 and one.support.dtype == np.uint8
        assert np.allclose(np.linalg.norm(one.normal, axis=-1), found, atol=1e-5)
        assert ((one.normal * view.camera.rays()).sum(-1)[found] < 0).all()
        assert (one.cost[~found] == 2).all() and (one.cost[found] < 2).all() and not one.support[~found].any()
        assert one.support.max() <= len(one.witnesses)


def test_background_is_never_searched(sphere, sphere_maps):
    for one, view in zip(sphere_maps, sphere.views, strict=True):
        assert not one.depth[view.alpha < 0.5].any()


def test_background_has_no_influence(sphere, sphere_maps):
    """Other colours outside the masks change neither the depth in their middle nor, by much, at their rims."""
    noise = np.random.default_rng(0)
    views = [
        replace(v, colour=np.where(v.alpha[..., None] < 0.5, noise.random(v.colour.shape, np.float32), v.colour)) for v in sphere.views
    ]
    depth, _, kept = errors(sphere, estimated(replace(sphere, views=views)))
    before, _, kept_before = errors(sphere, sphere_maps)
    assert kept > kept_before - 0.05 and np.median(depth) < 1.2 * np.median(before)


def test_texture_is_needed(flat_plane):
    maps = estimated(flat_plane)
    assert not any(one.support.any() or one.depth.any() for one in maps)


def test_bounds_hold_for_each_pixel(sphere):
    """The true depth lies within the bounds in the left half of each image only; the lowest rows are left out."""
    nearest, farthest = [], []
    for true in sphere.depth:
        low, high = np.where(true > 0, true - 0.1, 2.5), np.where(true > 0, true + 0.1, 5.5)
        low[:, 32:], high[:, 32:] = 1.0, 1.6
        low[50:] = 0
        nearest.append(low.astype(np.float32))
        farthest.append(high.astype(np.float32))
    maps = estimated(sphere, nearest, farthest)
    for one, low, high in zip(maps, nearest, farthest, strict=True):
        found = one.depth > 0
        assert (one.depth[found] >= low[found]).all() and (one.depth[found] <= high[found]).all()
        assert not one.depth[50:].any() and one.support[:50, :32].any() and not one.support[:, 32:].any()


def test_first_depths_help(sphere):
    """A single coarse sweep finds more of the surface where it starts near it."""
    brief = StereoSettings(coarse_sweeps=1, fine_sweeps=0, geometric_sweeps=0)
    wide = {"nearest": 0.3, "farthest": 30.0, "settings": brief}
    points = np.random.default_rng(2).normal(size=(3000, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    points = points[points[:, 2] > 0.2]
    none, near_points, near_guess = (
        errors(sphere, estimated(sphere, **wide, **start))[2] for start in ({}, {"points": points}, {"initial": sphere.depth})
    )
    assert near_points > 1.5 * none and near_guess > 1.5 * none


def test_same_maps_for_any_number_of_threads(sphere, sphere_maps, monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", "1")
    for one, other in zip(sphere_maps, estimated(sphere), strict=True):
        for layer in ("depth", "normal", "cost", "support"):
            assert np.array_equal(getattr(one, layer), getattr(other, layer))


def test_images_of_several_sizes(sphere, camera_arc):
    """Odd sizes too: the last row and column have no pixel at half the resolution."""
    views, depths, normals = list(sphere.views), list(sphere.depth), list(sphere.normal)
    v = views[2]
    camera = replace(v.camera, width=61, height=55)
    views[2] = replace(v, camera=camera, colour=v.colour[:55, :61], alpha=v.alpha[:55, :61])
    depths[2], normals[2] = depths[2][:55, :61], normals[2][:55, :61]
    scene = replace(sphere, views=views, depth=depths, normal=normals)
    depth, _, kept = errors(scene, estimated(scene))
    assert kept > 0.6 and np.median(depth) < 0.006


def test_a_view_that_looks_away_stays_empty(sphere):
    camera = sphere.views[0].camera
    away = replace(camera, to_world=camera.to_world @ np.diag([-1.0, 1.0, -1.0, 1.0]))
    said = []
    progress = Silent()
    progress.message = said.append
    views = [replace(sphere.views[0], name="away", camera=away), *sphere.views[1:4]]
    points = sphere.views[1].camera.centre + sphere.depth[1][..., None] * sphere.views[1].camera.rays()
    maps = estimated(replace(sphere, views=views), points=points[sphere.depth[1] > 0], progress=progress)
    assert not maps[0].depth.any() and maps[0].witnesses == () and maps[1].support.any()
    assert said == ["stereo: away shares no points with other views"]


class Stopped(Silent):
    """Progress that is cancelled after a number of steps."""

    def __init__(self, after):
        self.after, self.phases, self.steps = after, [], []

    @property
    def cancelled(self):
        return len(self.steps) >= self.after

    def phase(self, name, steps):
        self.phases.append((name, steps))

    def step(self, done, **metrics):
        self.steps.append(done)


def test_progress_and_cancellation(sphere):
    brief, progress = StereoSettings(coarse_sweeps=0, fine_sweeps=0), Stopped(after=99)
    estimated(sphere, settings=brief, progress=progress)
    assert progress.phases == [("stereo", 12)] and progress.steps == list(range(1, 13))
    with pytest.raises(Cancelled):
        estimated(sphere, settings=brief, progress=(progress := Stopped(after=3)))
    assert progress.steps == [1, 2, 3]


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="9 best of 8"):
        StereoSettings(best=9)
