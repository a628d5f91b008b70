# SPDX-License-Identifier: GPL-3.0-or-later
"""The start that is refined is the one that held-back views prefer after a trial."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from irgspp.core.stages.second.refinement import refinement_selection as module
from irgspp.core.stages.second.refinement.refinement_selection import MAX_LOSS, METAL_STEPS_FACTOR, TRIAL_SHARE, refine

SETTINGS = with_overrides(Settings(), ["second.iterations=10", "second.pixels=64", "second.samples=16", "second.pool=2000"])


@pytest.fixture(scope="module")
def dataset(sphere_dataset, camera_ring):
    return sphere_dataset(camera_ring(10, size=40))


@pytest.fixture(scope="module")
def start(splat_sphere):
    """Function that makes a sphere of a given albedo under a white sky."""

    def make(albedo):
        material = torch.tensor([*albedo, 0.5, 0.02])[:, None].expand(5, 3000)
        surfels = replace(splat_sphere(3000, opacity=0.999), material=torch.logit(material).contiguous())
        return Reconstruction(surfels, torch.ones(8, 16, 3), Bound((0.0, 0.0, 0.0), 1.5), np.eye(4))

    return make


class Listener(Silent):
    """Progress that records steps and messages."""

    def __init__(self, cancel_after=None):
        self.steps, self.messages, self.cancel_after = [], [], cancel_after

    def step(self, step, loss=None):
        self.steps.append(step)

    def message(self, text):
        self.messages.append(text)

    @property
    def cancelled(self):
        return len(self.steps) == self.cancel_after


def test_better_start_is_refined_to_the_end(start, dataset):
    good, bad = start((0.6, 0.45, 0.3)), start((0.05, 0.9, 0.9))
    listener = Listener()
    refined, scale = refine([bad, good], dataset, SecondaryTracer(good), SETTINGS, listener, None)
    trial = int(TRIAL_SHARE * SETTINGS.second.iterations)
    assert listener.steps == [*range(1, trial + 1), *range(1, trial + 1), *range(trial + 1, 11)] and scale == 1.0
    difference = (refined.gaussians.materials()[:3] - good.gaussians.materials()[:3]).abs()
    assert difference.mean() < 0.15
    assert "refined" in listener.messages[-1] and listener.messages[-1].count(",") == 2


def test_better_start_is_chosen_after_the_trial_not_before(start, dataset, monkeypatch):
    """The first looks better at once, the second after some steps."""
    curves = {0: (20.0, 21.0, 22.0), 1: (19.0, 23.0, 25.0)}
    runs = []

    monkeypatch.setattr(module, "_by_confidence", lambda result, *rest: result)

    class Scripted:
        settings = SETTINGS.second

        def __init__(self, number):
            self.number, self.done, self.start = number, 0, None

        def run(self, step):
            runs.append(self.number)
            while self.done < self.settings.iterations:
                self.done += 1
                if step(self.done):
                    return

        def test(self):
            return curves[self.number][0 if not self.done else 1 if self.done < self.settings.iterations else 2]

        def result(self):
            return f"refined {self.number}"

    monkeypatch.setattr(module, "prepare_refinements", lambda *_: [Scripted(0), Scripted(1)])
    monkeypatch.setattr(module, "pool_pixels", lambda *_: SimpleNamespace(count=1))
    found, _ = refine([start((0.5, 0.5, 0.5))], dataset, None, SETTINGS, Silent(), None)
    assert found == "refined 1" and runs == [0, 1, 1]


def test_refinement_that_does_not_help_is_discarded(start, dataset, monkeypatch):
    first = start((0.6, 0.45, 0.3))
    values = iter([20.0, 19.0])
    monkeypatch.setattr(module.Refinement, "test", lambda self: next(values))
    kept = refine([first], dataset, SecondaryTracer(first), SETTINGS, Silent(), None)[0]
    assert kept.gaussians.quaternion is first.gaussians.quaternion and kept.environment is first.environment
    assert torch.allclose(kept.gaussians.materials(), first.gaussians.materials(), atol=1e-6)  # one roughness, so nothing to pool
    assert kept.confidence is not None


def test_refinement_that_is_hardly_worse_on_few_views_is_kept(start, dataset, monkeypatch):
    first = start((0.6, 0.45, 0.3))
    values = iter([20.0, 20.0 - 0.9 * MAX_LOSS])
    monkeypatch.setattr(module.Refinement, "test", lambda self: next(values))
    kept = refine([first], dataset, SecondaryTracer(first), SETTINGS, Silent(), None)[0]
    assert not torch.equal(kept.environment, first.environment)


def test_roughness_is_pooled_where_the_object_is_no_metal(start, dataset, monkeypatch):
    first, known = start((0.6, 0.45, 0.3)), []
    monkeypatch.setattr(module, "with_pooled_roughness", lambda result, seed: known.append(result.confidence) or result)
    for metallic, count in ((0.02, 1), (0.99, 1)):  # the second, a metal, adds none
        material = first.gaussians.materials().clone()
        material[4] = metallic
        given = first.relabelled(torch.logit(material), first.environment)
        assert refine([given], dataset, SecondaryTracer(given), SETTINGS, Silent(), None)[0].confidence is not None
        assert len(known) == count and known[0].shape == (3, 3000)


def test_metals_have_a_longer_schedule(start, dataset):
    first = start((0.6, 0.45, 0.3))
    metal = torch.logit(torch.tensor([0.6, 0.5, 0.4, 0.3, 0.99]))[:, None].expand(5, 3000).contiguous()
    listener = Listener()
    refine([first.relabelled(metal, first.environment)], dataset, SecondaryTracer(first), SETTINGS, listener, None)
    assert listener.steps[-1] == METAL_STEPS_FACTOR * SETTINGS.second.iterations


def test_no_iterations_keep_the_first_start(start, dataset):
    first = start((0.6, 0.45, 0.3))
    settings = with_overrides(SETTINGS, ["second.iterations=0"])
    assert refine([first, first], dataset, SecondaryTracer(first), settings, Silent(), None) == (first, 1.0)


def test_trials_can_be_cancelled(start, dataset):
    first = start((0.6, 0.45, 0.3))
    with pytest.raises(Cancelled):
        refine([first, first], dataset, SecondaryTracer(first), SETTINGS, Listener(cancel_after=1), None)


def test_all_starts_share_the_schedule_of_the_deadline(start, dataset, monkeypatch):
    first, lengths = start((0.6, 0.45, 0.3)), []
    monkeypatch.setattr(module, "_best_after_trial", lambda refinements, progress: lengths.extend(refinements) or refinements[0])
    _, scale = refine([first, first], dataset, SecondaryTracer(first), SETTINGS, Silent(), time.monotonic() + 0.01)
    assert scale < 1
    assert len({refinement.settings.iterations for refinement in lengths}) == 1
