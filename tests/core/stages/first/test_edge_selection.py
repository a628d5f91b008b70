# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection between open and closed edges, with given results of the trial fits and with real ones."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import edge_selection
from irgspp.core.stages.first.edge_selection import CLOSED, OPEN, OPEN_EDGES, select_open_edges
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GLOSSY, METAL
from irgspp.core.stages.first.start import Start
from irgspp.core.stages.first.start_trials import StartTrials
from recorded_decisions import RecordedDecisions

SETTINGS = replace(preset("draft"), first=replace(preset("draft").first, open_edges=None, start_trials=True))


@pytest.fixture
def scene(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(12, 32))
    return dataset, Start(initial_gaussians(dataset, 100, np.random.default_rng(0)))


@pytest.fixture
def no_trials(monkeypatch):
    monkeypatch.setattr(edge_selection, "run_trials", lambda *_: pytest.fail("a trial was run"))


@pytest.mark.parametrize(("gain", "part"), [(1.0, OPEN_EDGES), (0.01, OPEN_EDGES), (0.0, 0.0), (-0.01, 0.0)])
def test_held_back_views_decide(scene, monkeypatch, gain, part):
    parts = {}

    def run(fits, *_):
        parts.update({name: fit.settings.open_edges for name, fit in fits.items()})
        return {CLOSED: 30.0, OPEN: 30.0 + gain}, []

    monkeypatch.setattr(edge_selection, "run_trials", run)
    progress = RecordedDecisions()
    assert select_open_edges(scene[1], StartTrials(scene[0], SETTINGS, GLOSSY), progress) == part
    assert parts == {CLOSED: 0.0, OPEN: OPEN_EDGES}
    assert progress.found == {"open_edges": (part > 0, f"held-back views: closed 30.00 dB, open {30 + gain:.2f} dB")}


@pytest.mark.parametrize("part", [0.0, 0.25])
def test_a_number_decides_without_a_trial(scene, no_trials, part):
    progress = RecordedDecisions()
    settings = with_overrides(SETTINGS, [f"first.open_edges={part}"])
    assert select_open_edges(scene[1], StartTrials(scene[0], settings, GLOSSY), progress) == part
    assert progress.found == {"open_edges": (part > 0, "as set")}


@pytest.mark.parametrize(
    ("views", "masked", "material_class", "tried"),
    [(12, True, METAL, True), (12, False, GLOSSY, True), (7, True, GLOSSY, True), (12, True, GLOSSY, False)],
)
def test_edges_stay_closed_where_no_trial_can_tell(sphere_dataset, camera_ring, no_trials, views, masked, material_class, tried):
    dataset, progress = sphere_dataset(camera_ring(views, 32), masked=masked), RecordedDecisions()
    start = Start(initial_gaussians(dataset, 100, np.random.default_rng(0)))
    settings = replace(SETTINGS, first=replace(SETTINGS.first, start_trials=tried))
    assert select_open_edges(start, StartTrials(dataset, settings, material_class), progress) == 0
    on, evidence = progress.found["open_edges"]
    assert not on
    assert evidence.startswith("closed: ")


def test_trial_fits_are_finer_than_those_of_the_classes(scene):
    progress = RecordedDecisions()
    settings = with_overrides(SETTINGS, ["first.trial_iterations=5", "first.trial_gaussians=20", "first.trial_resolution=16"])
    sizes, fits = [], []
    prepare = edge_selection.prepare_trial

    def prepared(*arguments):
        fit = prepare(*arguments)
        sizes.append((fit.optimizer.gaussians.count, fit.training_views[0].image.shape[-1], fit.settings.iterations))
        fits.append(fit)
        return fit

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(edge_selection, "prepare_trial", prepared)
        select_open_edges(scene[1], StartTrials(scene[0], settings, GLOSSY), progress)
    assert sizes == [(50, 32, 10)] * 2
    assert [(fit.done, fit.settings.single_rays) for fit in fits] == [(3, 1.0)] * 2  # edges are open to the end of such a trial
    assert progress.phases == [("edges", 3)]
