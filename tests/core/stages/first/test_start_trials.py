# SPDX-License-Identifier: GPL-3.0-or-later
"""Trial fits of starts: their size, that each is made once, and what is reported."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import start_trials
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GLOSSY, LOW_GLOSS
from irgspp.core.stages.first.start import Start
from irgspp.core.stages.first.start_trials import StartTrials
from recorded_decisions import RecordedDecisions

SETTINGS = with_overrides(preset("draft"), ["first.trial_iterations=4", "first.trial_gaussians=20", "first.trial_resolution=16"])


@pytest.fixture
def scene(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(12, 32))
    return dataset, [Start(initial_gaussians(dataset, 100, np.random.default_rng(seed))) for seed in range(3)]


@pytest.mark.parametrize("masked", [False, True])
def test_fits_are_finer_than_those_of_the_classes_where_masks_tell_the_object(sphere_dataset, camera_ring, scene, masked):
    trials = StartTrials(sphere_dataset(camera_ring(12, 32), masked=masked), with_overrides(SETTINGS, ["first.open_edges=0.5"]), LOW_GLOSS)
    fit = trials.fit_of(scene[1][0])
    size = (50, 32) if masked else (20, 16)
    assert (fit.optimizer.gaussians.count, fit.training_views[0].image.shape[-1]) == size
    assert (fit.settings.single_rays, fit.settings.open_edges, fit.done) == (1, 0, 0)


def test_a_start_that_is_compared_again_is_not_fitted_again(scene, monkeypatch):
    dataset, (one, other, third) = scene
    trials, progress = StartTrials(dataset, SETTINGS, GLOSSY), RecordedDecisions()
    first = trials.compare({"one": one, "other": other}, progress, may_give_up=False)
    before = trials.fit_of(one).optimizer.gaussians.position.detach().clone()
    again = trials.compare({"kept": one, "third": third}, progress, may_give_up=False)
    assert again["kept"] == first["one"]
    assert torch.equal(trials.fit_of(one).optimizer.gaussians.position, before)
    assert [trials.fit_of(start).done for start in (one, other, third)] == [4, 4, 4]
    alone = StartTrials(dataset, SETTINGS, GLOSSY).compare({"third": third}, progress, may_give_up=False)
    assert again["third"] == alone["third"]


def test_a_fit_that_was_left_early_goes_on_where_it_is_compared_again(scene, monkeypatch):
    dataset, (one, other, _) = scene
    trials = StartTrials(dataset, SETTINGS, GLOSSY)
    trials.fit_of(one).step()
    trials.compare({"one": one, "other": other}, RecordedDecisions(), may_give_up=False)
    assert trials.fit_of(one).done == 4


@pytest.mark.parametrize(
    ("masked", "may_give_up", "given_up", "reported"),
    [(False, True, [], True), (True, True, [], False), (True, True, ["one after 2 of 4 steps"], True), (True, False, [], False)],
)
def test_what_was_given_up_is_reported(sphere_dataset, camera_ring, scene, monkeypatch, masked, may_give_up, given_up, reported):
    asked = []
    run = lambda fits, settings, progress: (asked.append(settings.skip.trials), ({"one": 30.0}, given_up))[1]  # noqa: E731
    monkeypatch.setattr(start_trials, "run_trials", run)
    trials, progress = StartTrials(sphere_dataset(camera_ring(12, 32), masked=masked), SETTINGS, LOW_GLOSS), RecordedDecisions()
    assert trials.compare({"one": scene[1][0]}, progress, may_give_up) == {"one": 30.0}
    assert asked == ["auto" if may_give_up else "off"]
    assert ("trials" in progress.found) == reported
    if reported:
        on, evidence = progress.found["trials"]
        assert on == bool(given_up)
        assert "2 of 4" in evidence or not given_up


def test_layered_regions_are_sought_once_for_the_same_surfels(sphere_dataset, camera_ring, some_gaussians, monkeypatch):
    sought = []
    monkeypatch.setattr(start_trials, "layered_regions", lambda points, *_: sought.append(points) or [np.ones(len(points), bool)])
    trials = StartTrials(sphere_dataset(camera_ring(8, 16)), preset("draft"), GLOSSY)
    start = Start(some_gaussians(20, 0))
    regions = trials.layered_regions(start)
    assert trials.layered_regions(replace(start, metal=torch.ones(20, dtype=torch.bool))) is regions and len(sought) == 1
    trials.layered_regions(Start(some_gaussians(20, 1)))
    assert len(sought) == 2
