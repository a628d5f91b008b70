# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection of the regions that begin as metal, with given results of the trial fits and with real ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import metal_selection, start_trials
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GLOSSY, LOW_GLOSS, METAL
from irgspp.core.stages.first.metal_selection import select_metal
from irgspp.core.stages.first.start import Start
from irgspp.core.stages.first.start_trials import StartTrials
from irgspp.core.stages.first.trial_fits import prepare_trial
from mirror_sphere import mirror_photographs
from recorded_decisions import RecordedDecisions

SETTINGS = with_overrides(
    preset("draft"), ["first.start_trials=true", "first.trial_iterations=4", "first.trial_gaussians=60", "first.trial_resolution=16"]
)


@pytest.fixture
def scene(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(12, 32))
    return dataset, Start(initial_gaussians(dataset, 200, np.random.default_rng(0)))


@pytest.fixture
def halves(scene, monkeypatch):
    """Two regions: the surfels on either side of x = 0, the left first."""
    left = scene[1].gaussians.position[0].numpy() < 0
    monkeypatch.setattr(start_trials, "layered_regions", lambda *_: [left, ~left])
    return left, ~left


@pytest.fixture
def no_trials(monkeypatch):
    monkeypatch.setattr(start_trials, "run_trials", lambda *_: pytest.fail("a trial was run"))


@pytest.mark.parametrize(("gains", "chosen"), [((1.3, 1.1), [0]), ((1.1, 1.3), [1]), ((2.0, 1.3), [0, 1]), ((1.2, 0.1), [])])
def test_held_back_views_decide_on_each_region(scene, halves, monkeypatch, gains, chosen):
    monkeypatch.setattr(metal_selection, "region_gains", lambda *_: list(gains))
    progress = RecordedDecisions()
    start = select_metal(scene[1], StartTrials(scene[0], SETTINGS, GLOSSY), progress)
    on, evidence = progress.found["metal_regions"]
    assert on == bool(chosen)
    assert evidence.startswith(f"{len(chosen)} of 2 regions")
    assert evidence.endswith(", ".join(f"{10 * np.log10(gain):+.1f} dB" for gain in gains))
    if not chosen:
        assert start is scene[1]
        return
    assert start.metal.tolist() == np.any([halves[index] for index in chosen], 0).tolist()
    assert start.gaussians is scene[1].gaussians


def test_all_regions_are_metal_as_set_without_a_trial(scene, halves, no_trials):
    progress = RecordedDecisions()
    assert select_metal(scene[1], StartTrials(scene[0], with_overrides(SETTINGS, ["first.metal_regions=on"]), GLOSSY), progress).metal.all()
    assert progress.found == {"metal_regions": (True, "2 regions whose points lie in several layers, as set")}


@pytest.mark.parametrize(
    ("views", "masked", "material_class", "choice"),
    [
        (12, True, METAL, "metal_regions=auto"),
        (12, True, LOW_GLOSS, "metal_regions=on"),
        (12, False, GLOSSY, "metal_regions=auto"),
        (7, True, GLOSSY, "metal_regions=auto"),
        (12, True, GLOSSY, "metal_regions=off"),
        (12, True, GLOSSY, "start_trials=false"),
    ],
)
def test_nothing_is_metal_where_no_trial_can_tell(sphere_dataset, camera_ring, halves, no_trials, views, masked, material_class, choice):
    dataset, progress = sphere_dataset(camera_ring(views, 32), masked=masked), RecordedDecisions()
    start = Start(initial_gaussians(dataset, 100, np.random.default_rng(0)))
    settings = with_overrides(SETTINGS, [f"first.{choice}"])
    assert select_metal(start, StartTrials(dataset, settings, material_class), progress) is start
    on, evidence = progress.found["metal_regions"]
    assert evidence
    assert not on


def test_no_trial_without_layers(scene, no_trials):
    progress = RecordedDecisions()
    assert select_metal(scene[1], StartTrials(scene[0], SETTINGS, GLOSSY), progress) is scene[1]
    assert progress.found == {"metal_regions": (False, "nowhere do the start's points lie in several layers")}


def test_trial_fits_differ_in_the_metal_alone(scene, halves, monkeypatch):
    fits, progress = {}, RecordedDecisions()
    run = start_trials.run_trials
    monkeypatch.setattr(start_trials, "run_trials", lambda tried, *rest: (fits.update(tried), run(tried, *rest))[1])
    settings = with_overrides(SETTINGS, ["first.open_edges=0.5"])
    select_metal(scene[1], StartTrials(scene[0], settings, GLOSSY), progress)
    assert progress.phases == [("metal", 4)]
    assert [fit.done for fit in fits.values()] == [4, 4]  # to the end, both with closed edges
    assert [fit.settings.open_edges for fit in fits.values()] == [0.0, 0.0]
    assert [fit.optimizer.gaussians.count for fit in fits.values()] == [150, 150]  # finer than the trial fits of the classes
    without, with_metal = (float(fit.optimizer.gaussians.materials()[4].mean().detach()) for fit in fits.values())
    assert without < 0.4
    assert with_metal > 0.8


def test_chrome_is_metal_and_paint_is_not(sphere_dataset, camera_ring, monkeypatch):
    cameras = camera_ring(24, 48)
    painted = sphere_dataset(cameras)
    mirror = mirror_photographs(cameras, [view.alpha for view in painted.train])
    settings = with_overrides(SETTINGS, ["first.trial_iterations=60", "first.trial_gaussians=600", "first.trial_resolution=24"])
    start = Start(initial_gaussians(painted, 1500, np.random.default_rng(0)))
    left = start.gaussians.position[0].numpy() < 0
    monkeypatch.setattr(start_trials, "layered_regions", lambda *_: [left, ~left])
    found = select_metal(start, StartTrials(mirror, settings, GLOSSY), Silent())
    assert found.metal is not None
    assert found.metal.all()
    assert select_metal(start, StartTrials(painted, settings, GLOSSY), Silent()).metal is None


def test_a_region_that_hardly_a_pixel_shows_is_not_compared(scene, monkeypatch):
    nothing = np.zeros(200, bool)
    one = nothing.copy()
    one[0] = True
    monkeypatch.setattr(start_trials, "layered_regions", lambda *_: [one])
    progress = RecordedDecisions()
    assert select_metal(scene[1], StartTrials(scene[0], SETTINGS, GLOSSY), progress).metal is None
    assert progress.found["metal_regions"][1].endswith("held-back views: not seen")


def test_a_trial_can_be_cancelled(scene, halves):
    progress = RecordedDecisions()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        select_metal(scene[1], StartTrials(scene[0], SETTINGS, GLOSSY), progress)


def test_a_trial_takes_the_metal_of_the_surfels_that_it_selects(scene):
    dataset, start = scene
    metal = start.gaussians.position[0] < 0
    trial = prepare_trial(dataset, replace(SETTINGS, seed=3), start.gaussians, GLOSSY, crop=False, metal=metal)
    chosen = trial.optimizer.gaussians
    assert chosen.count == 60
    expected = torch.where(chosen.position[0] < 0, METAL.material[4], GLOSSY.material[4])
    assert chosen.materials()[4].detach().numpy() == pytest.approx(expected.detach().numpy(), abs=1e-5)
