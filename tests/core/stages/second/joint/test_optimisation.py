# SPDX-License-Identifier: GPL-3.0-or-later
"""Joint optimisation of a sphere in one colour under a white sky, whose start is grey."""

import copy
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.progress.protocol import Silent
from irgspp.core.rendering.gbuffer import render_gbuffer
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surroundings import Surroundings
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings, paced, preset
from irgspp.core.stages.second.joint.irgs import irgs_start
from irgspp.core.stages.second.joint.model import JointModel
from irgspp.core.stages.second.joint.optimisation import JointOptimisation, camera_extent
from irgspp.core.stages.second.joint.radiance_start import with_all_radiance
from irgspp.core.stages.second.joint.solve import has_moved, optimise_jointly, refine_jointly

OPTIONS = ["first.subpixels=1", "second.light_height=8", "second.pixels=64", "second.samples=16", "second.joint_iterations=12"]
SETTINGS = with_overrides(Settings(), [*OPTIONS, "second.solver=joint"])
SPHERE = Bound((0.0, 0.0, 0.0), 1.5)


@dataclass
class Listener(Silent):
    """Progress that records, and stops the work after some iterations."""

    cancel_at: int = 10**9
    finish_at: int = 10**9
    done: int = 0
    cancelled: bool = False
    finish_early: bool = False
    messages: list = field(default_factory=list)
    decisions: list = field(default_factory=list)

    def step(self, done, **metrics):
        self.done = done
        self.cancelled, self.finish_early = done >= self.cancel_at, done >= self.finish_at

    def message(self, text):
        self.messages.append(text)

    def decided(self, rule, on, evidence):
        self.decisions.append((rule, on))

    def image(self, draw):
        assert draw().dtype == np.uint8


@pytest.fixture(scope="module")
def start(splat_sphere):
    return Reconstruction(splat_sphere(800, opacity=0.98), torch.ones(8, 16, 3), SPHERE, np.eye(4))


@pytest.fixture(scope="module")
def dataset(sphere_dataset, camera_ring):
    return sphere_dataset(camera_ring(9, size=40))


def optimisation(start, dataset, **second):
    settings = replace(SETTINGS.second, **second)
    return JointOptimisation(start, dataset.train, JointModel.of(start, None, 1, True), settings, 0, hold_back=True)


def test_held_back_views_are_shaded_better_and_the_same_each_time(start, dataset):
    results = []
    for _ in range(2):
        trial, losses = optimisation(start, dataset), []
        before = trial.test()
        trial.run(lambda done, loss, kept=losses: kept.append(loss))
        assert trial.test() > before + 0.3 and len(losses) == 12
        assert np.mean(losses[-3:]) < np.mean(losses[:3])
        results.append(trial.result())
    for name, value in results[0].gaussians.tensors().items():
        assert torch.equal(value, results[1].gaussians.tensors()[name]), name
        assert not torch.equal(value, start.gaussians.tensors()[name]), name  # everything is optimised
    assert torch.equal(results[0].environment, results[1].environment)
    assert has_moved(results[0], start)
    red, _, blue = results[0].gaussians.materials()[:3].mean(1)
    assert red > blue  # as in the photographs


def test_geometry_stays_where_its_rate_is_zero(start, dataset):
    trial = optimisation(start, dataset, geometry_rate=0.0)
    trial.run(lambda done, loss: done == 3)
    result = trial.result()
    for name, value in result.gaussians.tensors().items():
        assert torch.equal(value, start.gaussians.tensors()[name]) == (name not in ("sh", "material")), name
    assert not has_moved(result, start)


def test_confidence_of_the_start_is_not_that_of_the_result(start, dataset):
    known = replace(start, confidence=torch.ones(3, start.gaussians.count))
    assert optimisation(known, dataset).result().confidence is None


def test_indirect_light_and_visibility_can_be_left_out_alone(start, dataset):
    """Rays that start inside a closed surface meet it: its radiance arrives with indirect light, the light map's without visibility."""
    view = optimisation(start, dataset).training_views[0]
    light, incoming = torch.full((8, 16, 3), 2.0), {}
    for shadows in (True, False):
        for indirect in (True, False):
            model = JointModel.of(start, None, 1, indirect, shadows)
            sums = model.render(start.gaussians, view)
            plan = model.plan(sums, view, model.foreground(sums, view)[::9], light, (8, 4, 4), torch.Generator().manual_seed(0))
            inside = replace(model, radius=-5 * SPHERE.radius)  # of which a small part lies between surface and origin
            incoming[shadows, indirect] = inside.shade(start.gaussians, light, sums, view, plan)[1].flatten(0, 1)[plan.above]
    assert torch.allclose(incoming[False, False], torch.tensor(2.0), atol=1e-5)
    own = incoming[True, True] - incoming[True, False]
    assert torch.allclose(incoming[False, True], 2.0 + own, atol=1e-5) and own.mean() > 0.05
    assert incoming[True, False].mean() < 0.8


def test_the_baseline_has_no_metal_and_starts_with_constants(start, dataset):
    settings = with_overrides(SETTINGS, ["second.brdf=irgs", "second.geometry_rate=0", "second.joint_iterations=3"])
    fresh = irgs_start(start)
    assert torch.allclose(fresh.gaussians.materials().mean(1), torch.tensor([0.3, 0.3, 0.3, 0.6, 0.0]), atol=1e-4)
    assert (fresh.environment == 1.5).all()
    result, _ = optimise_jointly(start, dataset, settings, Listener())
    assert result.brdf == "irgs" and optimise_jointly(start, dataset, SETTINGS, Listener(finish_at=1))[0].brdf == "principled"
    albedo, roughness, metallic = result.gaussians.materials().split([3, 1, 1])
    assert metallic.max() < 1e-4 and 0 < (albedo - 0.3).abs().max() < 0.05 and 0 < (roughness - 0.6).abs().max() < 0.05


def test_held_back_views_are_never_drawn(start, dataset):
    trial = optimisation(start, dataset)
    for number in torch.nonzero(trial.held_back)[:, 0].tolist():
        trial.training_views[number] = None
    for _ in range(9):
        trial.step()


def test_progress_finishes_early_or_cancels(start, dataset):
    listener = Listener(finish_at=2)
    result, scale = optimise_jointly(start, dataset, SETTINGS, listener)
    assert (listener.done, scale) == (2, 1.0) and not result.has_split_sum
    assert sum("PSNR of shaded training views" in text for text in listener.messages) == 1
    with pytest.raises(Cancelled, match="iteration 3 of the joint optimisation"):
        optimise_jointly(start, dataset, SETTINGS, Listener(cancel_at=3))


def test_a_deadline_shortens_the_schedule(start, dataset):
    listener = Listener()
    settings = with_overrides(SETTINGS, ["second.joint_iterations=100000"])
    _, scale = optimise_jointly(start, dataset, settings, listener, deadline=0.0)  # long past
    assert scale == pytest.approx(1e-5) and any("joint optimisation: schedule" in text for text in listener.messages)


class Store(dict):
    """Checkpoints in memory, copied as a file would."""

    def save(self, name, state):
        self[name] = copy.deepcopy(state)

    def load(self, name):
        return self.get(name)


def test_a_cancelled_optimisation_resumes_to_the_same_result(start, dataset):
    settings = with_overrides(SETTINGS, ["second.joint_iterations=6"])
    whole, _ = optimise_jointly(start, dataset, settings, Silent())
    store = Store()
    with pytest.raises(Cancelled):
        optimise_jointly(start, dataset, settings, Listener(cancel_at=3), None, store)
    assert store["joint"]["done"] == 3
    resumed, _ = optimise_jointly(start, dataset, settings, Silent(), None, store)
    for name, value in whole.gaussians.tensors().items():
        assert torch.equal(value, resumed.gaussians.tensors()[name]), name
    assert torch.equal(whole.environment, resumed.environment)
    for name, wrong in (("done", 7), ("order", torch.tensor([99])), ("optimizer", {}), ("generator", None)):
        with pytest.raises(InputError, match=r"checkpoint/joint\.pt: holds no state"):
            optimise_jointly(start, dataset, settings, Silent(), None, Store(joint={**store["joint"], name: wrong}))


@pytest.mark.parametrize(("after", "kept"), [(20.3, True), (20.1, False), (19.0, False)])
def test_refinement_is_kept_only_where_held_back_views_gain(start, dataset, monkeypatch, after, kept):
    measured = [20.0, after]
    monkeypatch.setattr(JointOptimisation, "test", lambda self: measured.pop(0))
    listener = Listener(finish_at=1)
    result, _ = refine_jointly(start, dataset, SETTINGS, listener)
    assert listener.decisions == [("joint", kept)] and (result is start) != kept


def test_a_refined_glossy_reconstruction_keeps_its_reflections(start, dataset, monkeypatch):
    measured = [20.0, 21.0]
    monkeypatch.setattr(JointOptimisation, "test", lambda self: measured.pop(0))
    glossy = replace(start, has_split_sum=True)
    result, _ = refine_jointly(glossy, dataset, SETTINGS, Listener(finish_at=1))
    assert result.has_split_sum and result.reflections is not None
    assert torch.equal(result.gaussians.sh, start.gaussians.sh)
    assert torch.equal(result.reflections.material, start.gaussians.materials())
    assert not torch.equal(result.gaussians.material, start.gaussians.material)


def test_values_that_are_not_finite_are_named(start, dataset):
    trial = optimisation(start, dataset)
    for view in trial.training_views:
        view.image.fill_(torch.nan)
    with pytest.raises(IrgsppError, match="the joint optimisation's loss is not finite at iteration 1"):
        trial.step()
    trial = optimisation(start, dataset)
    trial.optimizer.rates["roughness"] = trial.optimizer.rates["roughness"].times(torch.inf)
    with pytest.raises(IrgsppError, match="roughness is not finite after iteration 1"):
        trial.step()


def test_photographs_that_do_not_fit_are_one_clear_line(start, dataset, sphere_dataset, camera_ring):
    turned = replace(dataset, train=[replace(view, light_rotation=np.eye(3)) for view in dataset.train])
    with pytest.raises(InputError, match=r"second\.solver: .* use --set second\.solver=closed$"):
        optimise_jointly(start, turned, SETTINGS, Silent())
    with pytest.raises(InputError, match=r"use --set second\.solver=closed, or data\.light=still"):
        optimise_jointly(start, replace(turned, lit_from_camera=True), SETTINGS, Silent())
    faint = replace(start, gaussians=replace(start.gaussians, opacity=start.gaussians.opacity - 20))
    with pytest.raises(InputError, match="no photograph shows the object"):
        optimise_jointly(faint, dataset, SETTINGS, Silent())


def test_without_masks_the_backdrop_is_neither_shaded_nor_met(start, sphere_dataset, camera_ring):
    """Surfels outside the bound are part of the distant light."""
    wall = start.gaussians.select(slice(None))
    wall.position = 3 * wall.position
    wall.log_scale = wall.log_scale + np.log(3)
    both = replace(start, gaussians=start.gaussians.joined(wall), background=torch.ones(4, 8, 3))
    near = Surroundings(np.full((5, 3), -1.2, np.float32), np.tile(np.float32([[0, 0, 1]]), (5, 1)), np.full((5, 3), 0.5), np.full(5, 0.1))
    model = JointModel.of(both, near, 1, True)
    assert model._occluders(both.gaussians).count == 800 + 5
    cameras = camera_ring(9, size=40, distance=2.9)  # inside the wall, 4.5 away on the other side
    trial = JointOptimisation(both, sphere_dataset(cameras, masked=False).train, model, SETTINGS.second, 0)
    sums = model.render(both.gaussians, trial.training_views[0])
    shown = model.foreground(sums, trial.training_views[0])
    assert 0 < len(shown) < (sums[-1] > 0.5).sum()
    trial.step()


def test_radiance_of_a_glossy_start_moves_into_its_sh(start, dataset):
    glossy = replace(start, has_split_sum=True, environment=torch.full((8, 16, 3), 0.8))
    material = torch.logit(torch.tensor([0.8, 0.5, 0.2, 0.5, 0.6]))[:, None].expand(5, 800).contiguous()
    glossy = replace(glossy, gaussians=replace(glossy.gaussians, material=material))
    plain = with_all_radiance(glossy, dataset.train, SETTINGS, Silent())
    assert not plain.has_split_sum and plain.mirrored() is None
    layers = render_gbuffer(plain, dataset.train[0].camera)
    inside = layers.alpha > 0.99
    assert np.abs(layers.radiance[inside] - [0.604, 0.214, 0.033]).mean() < 0.03  # (0.8, 0.5, 0.2) in linear light
    assert with_all_radiance(start, dataset.train, SETTINGS, Silent()) is start


def test_pace_scales_all_schedules():
    slow = with_overrides(preset("paper"), ["pace=0.05", "second.iterations=0"])
    fast = paced(slow)
    assert slow.second.solver == "joint"
    assert (fast.first.iterations, fast.second.joint_iterations, fast.second.iterations) == (2500, 500, 0)
    assert fast.second.radiance_iterations == 8 and paced(replace(slow, pace=1e-4)).second.radiance_iterations == 1
    assert paced(preset("balanced")) == preset("balanced")


def test_the_cameras_have_an_extent(camera_ring):
    assert camera_extent(camera_ring(60)) == pytest.approx(4.4, rel=0.02)
