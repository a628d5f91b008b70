# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection of the regions that begin as metal by the colours of their points."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from images_in_a_ball import CENTRE, IMAGES, RADIUS, anchored, entered, images_in_a_ball
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import mirror_selection, start_trials
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GLOSSY, LOW_GLOSS, METAL
from irgspp.core.stages.first.mirror_selection import MIN_COLOUR_CHANGE, MIN_SPREAD, select_mirrors
from irgspp.core.stages.first.start import Start
from irgspp.core.stages.first.start_trials import StartTrials
from mirror_sphere import mirror_photographs
from recorded_decisions import RecordedDecisions

SETTINGS = with_overrides(preset("draft"), ["first.start_trials=true"])


@pytest.fixture(autouse=True)
def no_trials(monkeypatch):
    monkeypatch.setattr(start_trials, "run_trials", lambda *_: pytest.fail("a trial was run"))


@pytest.fixture
def cameras(camera_ring):
    return camera_ring(24, 48)


@pytest.fixture
def half_chrome(cameras, sphere_dataset):
    """A sphere that is chrome where x < 0 and painted elsewhere, and its start."""
    painted = sphere_dataset(cameras)
    depths = [entered(camera, np.zeros(3), 1.0) for camera in cameras]
    chrome, views = mirror_photographs(cameras, [view.alpha for view in painted.train]).train, []
    for paint, mirror, depth in zip(painted.train, chrome, depths, strict=True):
        left = (paint.camera.centre[0] + paint.camera.rays()[..., 0] * depth < 0)[..., None]
        views.append(replace(paint, colour=np.where(left, mirror.colour, paint.colour)))
    start = Start(initial_gaussians(painted, 1500, np.random.default_rng(0)), anchored(depths))
    return replace(painted, train=views), start


@pytest.fixture
def halves(half_chrome, monkeypatch):
    left = half_chrome[1].gaussians.position[0].numpy() < -0.1
    right = half_chrome[1].gaussians.position[0].numpy() > 0.5
    monkeypatch.setattr(start_trials, "layered_regions", lambda *_: [right, left])
    return left


def test_the_colours_tell_chrome_from_paint(half_chrome, halves):
    dataset, start = half_chrome
    progress = RecordedDecisions()
    found = select_mirrors(start, StartTrials(dataset, SETTINGS, GLOSSY), progress)
    assert found.metal.tolist() == halves.tolist()
    on, evidence = progress.found["mirrors"]
    assert on and evidence.startswith("1 of 2 regions")
    assert found.anchors is start.anchors
    assert torch.equal(found.gaussians.position, start.gaussians.position)  # the points lie on the hull already


@pytest.mark.parametrize(("spread", "chosen"), [(1.01 * MIN_SPREAD, True), (0.99 * MIN_SPREAD, False)])
def test_the_spread_is_compared_with_that_of_the_other_points(half_chrome, halves, monkeypatch, spread, chosen):
    monkeypatch.setattr(mirror_selection, "colour_spread", lambda *_: np.where(halves, 0.03 * spread, 0.03))
    dataset, start = half_chrome
    found = select_mirrors(start, StartTrials(dataset, SETTINGS, GLOSSY), RecordedDecisions())
    assert (found.metal is not None) == chosen and (found is start) != chosen


@pytest.mark.parametrize(("change", "chosen"), [(1.01 * MIN_COLOUR_CHANGE, True), (0.99 * MIN_COLOUR_CHANGE, False)])
def test_highlights_in_gloss_change_less_than_a_mirror(half_chrome, halves, monkeypatch, change, chosen):
    monkeypatch.setattr(mirror_selection, "colour_spread", lambda *_: np.where(halves, change, 0.1 * change))
    dataset, start = half_chrome
    found = select_mirrors(start, StartTrials(dataset, SETTINGS, GLOSSY), RecordedDecisions())
    assert (found.metal is not None) == chosen


def test_no_trial_fits_are_needed(half_chrome, halves):
    dataset, start = half_chrome
    settings = with_overrides(SETTINGS, ["first.start_trials=false"])
    assert select_mirrors(start, StartTrials(dataset, settings, GLOSSY), RecordedDecisions()).metal.tolist() == halves.tolist()


def test_known_metal_is_kept_and_not_tried_again(half_chrome, halves):
    dataset, start = half_chrome
    metal = torch.from_numpy(halves)
    progress = RecordedDecisions()
    found = select_mirrors(replace(start, metal=metal), StartTrials(dataset, SETTINGS, GLOSSY), progress)
    assert torch.equal(found.metal, metal)
    assert "0 of 1" in progress.found["mirrors"][1]


def test_images_deep_in_a_ball_are_moved_onto_it(camera_ring, sphere_dataset, some_gaussians, monkeypatch):
    views, anchors, images = images_in_a_ball(camera_ring(24, 96))
    rng = np.random.default_rng(0)
    away = rng.normal(size=(100, 3))
    away = 1.2 * away / np.linalg.norm(away, axis=1, keepdims=True)
    points = np.concatenate([images[rng.choice(len(images), 2000)], away])
    gaussians = some_gaussians(len(points), 0)
    gaussians = replace(gaussians, position=torch.from_numpy(points.T.astype(np.float32)))
    region = np.arange(len(points)) < 2000
    monkeypatch.setattr(start_trials, "layered_regions", lambda *_: [region])
    monkeypatch.setattr(mirror_selection, "colour_spread", lambda *_: np.where(region, 1.0, 0.1))
    dataset = sphere_dataset(camera_ring(24, 96))
    dataset = replace(dataset, train=[replace(view, alpha=np.ones(view.colour.shape[:2], np.float32)) for view in views])
    dataset = replace(dataset, bound=replace(dataset.bound, radius=1.0))
    found = select_mirrors(Start(gaussians, anchors), StartTrials(dataset, SETTINGS, GLOSSY), RecordedDecisions())
    assert found.metal.tolist() == region.tolist()
    offset = found.gaussians.position.T.double().numpy()[region] - CENTRE
    distance = np.linalg.norm(offset, axis=1)
    assert IMAGES + 0.15 < np.median(distance) / RADIUS < 1.05
    assert np.median((found.gaussians.normals().T.numpy()[region] * offset).sum(1) / distance) > 0.95
    assert torch.equal(found.gaussians.position[:, ~region], gaussians.position[:, ~region])


@pytest.mark.parametrize(
    ("choice", "material_class", "with_depths"),
    [("off", GLOSSY, True), ("auto", LOW_GLOSS, True), ("auto", METAL, True), ("auto", GLOSSY, False)],
)
def test_nothing_is_a_mirror_where_nothing_can_tell(half_chrome, halves, choice, material_class, with_depths):
    dataset, start = half_chrome
    start, progress = (start if with_depths else Start(start.gaussians)), RecordedDecisions()
    settings = with_overrides(SETTINGS, [f"first.metal_regions={choice}"])
    assert select_mirrors(start, StartTrials(dataset, settings, material_class), progress) is start
    on, evidence = progress.found["mirrors"]
    assert evidence and not on


def test_nothing_is_a_mirror_without_layers(half_chrome, monkeypatch):
    monkeypatch.setattr(start_trials, "layered_regions", lambda *_: [])
    dataset, start = half_chrome
    assert select_mirrors(start, StartTrials(dataset, SETTINGS, GLOSSY), RecordedDecisions()) is start
