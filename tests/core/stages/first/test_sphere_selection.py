# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection of the regions that begin as balls of metal, with given results of the trial fits and with real ones."""

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.first import sphere_selection, start_trials
from irgspp.core.stages.first.depth_anchors import COMPARED_VIEWS, DepthAnchors
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GLOSSY, METAL
from irgspp.core.stages.first.mirror_sphere import MirrorSphere
from irgspp.core.stages.first.sphere_selection import select_spheres
from irgspp.core.stages.first.start import Start
from irgspp.core.stages.first.start_trials import StartTrials
from mirror_sphere import mirror_photographs
from recorded_decisions import RecordedDecisions

SETTINGS = with_overrides(
    preset("draft"), ["first.start_trials=true", "first.trial_iterations=4", "first.trial_gaussians=60", "first.trial_resolution=16"]
)
BALL, SPECK = MirrorSphere(np.zeros(3), 1.0), MirrorSphere(np.full(3, 9.0), 0.1)


def start_of(dataset, count=200):
    """A start on the hull, with the anchors of a stereo that saw nothing."""
    views = len(dataset.train)
    nothing = DepthAnchors(
        torch.zeros(views + 1, dtype=torch.int64),
        torch.zeros(0, dtype=torch.int32),
        torch.zeros(0),
        torch.full((views, COMPARED_VIEWS), -1),
    )
    return Start(initial_gaussians(dataset, count, np.random.default_rng(0)), nothing)


@pytest.fixture
def scene(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(12, 32))
    return dataset, start_of(dataset)


@pytest.fixture
def ball(monkeypatch):
    """One region of all surfels, and a ball in it."""
    monkeypatch.setattr(start_trials, "layered_regions", lambda points, *_: [np.ones(len(points), bool)])
    monkeypatch.setattr(sphere_selection, "mirror_sphere", lambda *_: BALL)


@pytest.mark.parametrize(("gain", "chosen"), [(1.3, True), (1.2, False)])
def test_held_back_views_decide(scene, ball, monkeypatch, gain, chosen):
    monkeypatch.setattr(sphere_selection, "region_gains", lambda *_: [gain])
    progress = RecordedDecisions()
    start = select_spheres(scene[1], StartTrials(scene[0], SETTINGS, GLOSSY), progress)
    evidence = f"{int(chosen)} of 1 balls around regions whose points lie in several layers; held-back views: {10 * np.log10(gain):+.1f} dB"
    assert progress.found == {"mirror_spheres": (chosen, evidence)}
    if not chosen:
        assert start is scene[1]
        return
    held = BALL.holds(scene[1].gaussians.position.T.double().numpy())
    assert start.metal.tolist() == held.tolist() and held.any()
    assert torch.allclose(start.gaussians.position[:, held].norm(dim=0), torch.tensor(1.0), atol=1e-5)
    assert start.anchors is scene[1].anchors


def test_balls_are_taken_as_set_without_a_trial(scene, ball, monkeypatch):
    monkeypatch.setattr(start_trials, "run_trials", lambda *_: pytest.fail("a trial was run"))
    start = select_spheres(
        scene[1], StartTrials(scene[0], with_overrides(SETTINGS, ["first.metal_regions=on"]), GLOSSY), RecordedDecisions()
    )
    assert start.metal.any()


@pytest.mark.parametrize(
    ("choice", "material_class", "anchored", "sphere"),
    [
        ("off", GLOSSY, True, BALL),
        ("auto", METAL, True, BALL),
        ("auto", GLOSSY, False, BALL),
        ("auto", GLOSSY, True, None),
        ("on", GLOSSY, True, SPECK),
    ],
)
def test_nothing_is_a_ball_where_none_can_be_found(scene, ball, monkeypatch, choice, material_class, anchored, sphere):
    monkeypatch.setattr(start_trials, "run_trials", lambda *_: pytest.fail("a trial was run"))
    monkeypatch.setattr(sphere_selection, "mirror_sphere", lambda *_: sphere)
    start, progress = scene[1] if anchored else Start(scene[1].gaussians), RecordedDecisions()
    settings = with_overrides(SETTINGS, [f"first.metal_regions={choice}"])
    assert select_spheres(start, StartTrials(scene[0], settings, material_class), progress) is start
    on, evidence = progress.found["mirror_spheres"]
    assert evidence and not on


def test_chrome_is_a_ball_of_metal_and_paint_is_not(sphere_dataset, camera_ring, ball):
    cameras = camera_ring(24, 48)
    painted = sphere_dataset(cameras)
    mirror = mirror_photographs(cameras, [view.alpha for view in painted.train])
    settings = with_overrides(SETTINGS, ["first.trial_iterations=60", "first.trial_gaussians=600", "first.trial_resolution=24"])
    start, progress = start_of(painted, 1500), RecordedDecisions()
    assert select_spheres(start, StartTrials(mirror, settings, GLOSSY), progress).metal is not None
    assert progress.phases == [("spheres", 60)]
    assert select_spheres(start, StartTrials(painted, settings, GLOSSY), progress).metal is None


def test_a_trial_can_be_cancelled(scene, ball):
    progress = RecordedDecisions()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        select_spheres(scene[1], StartTrials(scene[0], SETTINGS, GLOSSY), progress)
