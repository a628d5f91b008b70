# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection among the starts that dense stereo offers, with given results of stereo and of the trial fits."""

import numpy as np
import pytest
import torch
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import start_selection
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GLOSSY, LOW_GLOSS
from irgspp.core.stages.first.start_trials import StartTrials
from irgspp.core.stages.first.stereo_start import StereoStart
from recorded_decisions import RecordedDecisions

SETTINGS = with_overrides(preset("draft"), ["first.anchor_weight=0", "first.start_trials=true"])  # the starts have no depth maps


@pytest.fixture
def scene(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(12, 32))
    return dataset, initial_gaussians(dataset, 100, np.random.default_rng(0))


@pytest.fixture
def psnr(scene, monkeypatch):
    """PSNR in dB of the trial fits by start, for a test to fill: "one" has 1 surfel, "other" has 2. "one" is the only start if empty."""
    found = [StereoStart(name, scene[1].select(torch.arange(k)), 0.1 * k, []) for k, name in ((1, "one"), (2, "other"))]
    values: dict[str, float] = {}
    monkeypatch.setattr(start_selection, "from_stereo", lambda *_, everywhere: found[1:] if everywhere else found[: len(values) or 1])
    compare = lambda self, starts, *_, may_give_up: {name: values[name] for name in starts}  # noqa: E731
    monkeypatch.setattr(StartTrials, "compare", compare)
    return values


@pytest.mark.parametrize(("given", "size"), [({"one": 30.1, "other": 30.0}, 1), ({"one": 30.1, "other": 30.2}, 2), ({}, 1)])
def test_held_back_views_decide_between_two_starts(scene, psnr, given, size):
    psnr |= given
    progress = RecordedDecisions()
    assert start_selection.select_start(scene[1], StartTrials(scene[0], SETTINGS, LOW_GLOSS), progress).gaussians.count == size
    on, evidence = progress.found["stereo"]
    assert on
    assert ("held-back" in evidence) == bool(given)
    assert all(f"{name} {value:.2f} dB" in evidence for name, value in given.items())


@pytest.mark.parametrize(("gain", "differs", "size"), [(0.3, True, 3), (0.1, True, 2), (0.3, False, 2)])
def test_gaps_of_the_better_start_are_open_where_that_differs_and_held_back_views_say_so(scene, psnr, monkeypatch, gain, differs, size):
    opened = StereoStart("open", scene[1].select(torch.arange(3)), 0.5, []) if differs else None
    closed = StereoStart("closed", scene[1].select(torch.arange(2)), 0.5, [], lambda: opened)
    worse = StereoStart("worse", scene[1].select(torch.arange(1)), 0.5, [], lambda: pytest.fail("the gaps of the worse start were opened"))
    monkeypatch.setattr(start_selection, "from_stereo", lambda *_, everywhere: [worse, closed])
    psnr |= {"worse": 29.0, "closed": 30.0, "open": 30.0 + gain}
    progress = RecordedDecisions()
    assert start_selection.select_start(scene[1], StartTrials(scene[0], SETTINGS, LOW_GLOSS), progress).gaussians.count == size
    assert [name for name, _ in progress.phases] == (["start", "gaps"] if differs else ["start"])
    assert (f"open {30 + gain:.2f} dB" in progress.found["stereo"][1]) == differs


@pytest.mark.parametrize(("opened", "vessel", "size"), [(30.3, 30.4, 4), (30.7, 30.6, 3), (30.1, 30.1, 2), (None, 30.6, 4)])
def test_the_better_of_open_gaps_and_a_vessel_is_taken(scene, psnr, monkeypatch, opened, vessel, size):
    made = {count: StereoStart(f"{count}", scene[1].select(torch.arange(count)), 0.5, []) for count in (3, 4)}
    closed = StereoStart("2", scene[1].select(torch.arange(2)), 0.5, [], lambda: made[3] if opened else None, lambda _: made[4])
    monkeypatch.setattr(start_selection, "from_stereo", lambda *_, everywhere: [closed])
    psnr |= {"2": 30.0, "3": opened, "4": vessel}
    assert start_selection.select_start(scene[1], StartTrials(scene[0], SETTINGS, LOW_GLOSS), RecordedDecisions()).gaussians.count == size


def test_without_trials_gaps_stay_closed(scene, monkeypatch):
    closed = StereoStart("closed", scene[1].select(torch.arange(2)), 0.5, [], lambda: pytest.fail("gaps were opened"))
    monkeypatch.setattr(start_selection, "from_stereo", lambda *_, everywhere: [closed])
    for overrides in (["first.stereo=on"], ["first.start_trials=false"]):
        trials = StartTrials(scene[0], with_overrides(SETTINGS, overrides), LOW_GLOSS)
        assert start_selection.select_start(scene[1], trials, RecordedDecisions()).gaussians.count == 2


def test_stereo_as_set_takes_all_of_its_points_without_a_trial(scene, psnr):
    progress = RecordedDecisions()
    settings = with_overrides(SETTINGS, ["first.stereo=on"])
    assert start_selection.select_start(scene[1], StartTrials(scene[0], settings, LOW_GLOSS), progress).gaussians.count == 2
    assert progress.found["stereo"] == (True, "as set")


@pytest.mark.parametrize(("told", "size"), [(True, 3), (False, 2)])
def test_without_trials_a_vessel_is_taken_where_depths_tell_it(scene, monkeypatch, told, size):
    vessel = StereoStart("vessel", scene[1].select(torch.arange(3)), 0.5, [])
    closed = StereoStart("closed", scene[1].select(torch.arange(2)), 0.5, [], None, lambda least: vessel if told and least > 0.7 else None)
    monkeypatch.setattr(start_selection, "from_stereo", lambda *_, everywhere: [closed])
    monkeypatch.setattr(StartTrials, "compare", lambda *_, **__: pytest.fail("a trial was run"))
    progress, settings = RecordedDecisions(), with_overrides(SETTINGS, ["first.start_trials=false"])
    assert start_selection.select_start(scene[1], StartTrials(scene[0], settings, LOW_GLOSS), progress).gaussians.count == size
    assert progress.found["stereo"][1].startswith("50.0% of the surfels of " + ("vessel" if told else "closed"))


@pytest.mark.parametrize(("starts", "gloss_gain", "size"), [(1, 0.0, 1), (2, 0.0, 2), (2, 0.5, 2), (2, 0.9, 1)])
def test_without_trials_all_points_are_taken_and_those_of_regions_on_a_clearly_glossy_object(
    scene, psnr, monkeypatch, starts, gloss_gain, size
):
    psnr |= {name: 30.0 for name in ("one", "other")[:starts]}  # the number of starts
    monkeypatch.setattr(StartTrials, "compare", lambda *_, **__: pytest.fail("a trial was run"))
    progress, settings = RecordedDecisions(), with_overrides(SETTINGS, ["first.start_trials=false"])
    trials = StartTrials(scene[0], settings, GLOSSY, gloss_gain=gloss_gain)
    assert start_selection.select_start(scene[1], trials, progress).gaussians.count == size
    on, evidence = progress.found["stereo"]
    assert on
    assert evidence.endswith("lie on its points")


def test_without_masks_a_trial_is_always_made(sphere_dataset, camera_ring, psnr):
    dataset = sphere_dataset(camera_ring(12, 32), masked=False)
    plain = initial_gaussians(dataset, 100, np.random.default_rng(0))
    psnr |= {"sparse points": 30.0, "one": 31.0, "other": 29.0}
    progress, settings = RecordedDecisions(), with_overrides(SETTINGS, ["first.start_trials=false"])
    assert start_selection.select_start(plain, StartTrials(dataset, settings, LOW_GLOSS), progress).gaussians.count == 1
    assert "sparse points 30.00 dB" in progress.found["stereo"][1]
