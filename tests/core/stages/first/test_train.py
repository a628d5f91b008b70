# SPDX-License-Identifier: GPL-3.0-or-later
"""First stage at a small size: material class selection, improvement on held-back views, resuming from checkpoints."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.progress.protocol import Silent
from irgspp.core.scene.camera import Camera
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings, preset
from irgspp.core.stages.common.training_view import border_radiance, make_training_view
from irgspp.core.stages.first import trainer as trainer_module
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import GEOMETRY_RATES, GLOSSY, LOW_GLOSS, METAL, allowed_material_classes
from irgspp.core.stages.first.material_class_selection import SelectedClass, select_material_class
from irgspp.core.stages.first.train import train
from irgspp.core.stages.first.trainer import RATES_CHOSEN_AT, Trainer
from irgspp.core.stages.first.trial_fits import subsample
from mirror_sphere import mirror_photographs

SMALL = ("first.iterations=12", "first.gaussians=400", "first.light_height=16", "first.stereo=off", "first.open_edges=0")


def settings(*overrides: str) -> Settings:
    return with_overrides(preset("draft"), [*SMALL, *overrides])


class StopAfter(Silent):
    """Progress that cancels after a number of steps."""

    def __init__(self, steps: int) -> None:
        self.steps = steps

    def step(self, done: int, **figures: float) -> None:
        self.cancelled = done >= self.steps


class Memory(dict):
    """Checkpoint in memory."""

    def save(self, name, state):
        self[name] = state

    def load(self, name):
        return self.get(name)


def stopped(dataset, chosen) -> Memory:
    """The checkpoint of a fit that was cancelled after five steps."""
    memory = Memory()
    with pytest.raises(Cancelled):
        train(dataset, chosen, StopAfter(5), memory)
    return memory


@pytest.mark.parametrize(("materials", "masked"), [("low-gloss", True), ("low-gloss", False)])
def test_stopped_fit_goes_on_to_the_same_bits(sphere_dataset, camera_ring, materials, masked):
    dataset, chosen = sphere_dataset(camera_ring(9, 32), masked=masked), settings(f"materials={materials}")
    whole, _ = train(dataset, chosen)
    memory = stopped(dataset, chosen)
    assert memory["first_stage"]["done"] == 5
    resumed, _ = train(dataset, chosen, checkpoint=memory)
    for name, value in whole.gaussians.tensors().items():
        assert torch.equal(value, resumed.gaussians.tensors()[name]), name
    assert torch.equal(whole.environment, resumed.environment)


def test_stopped_fit_goes_on_with_the_edges_that_a_trial_chose(sphere_dataset, camera_ring, monkeypatch):
    dataset, chosen = sphere_dataset(camera_ring(9, 32)), settings("materials=low-gloss")
    closed, _ = train(dataset, chosen)
    monkeypatch.setattr("irgspp.core.stages.first.train.select_open_edges", lambda *_: 0.9)
    whole, _ = train(dataset, chosen)
    memory = stopped(dataset, chosen)
    monkeypatch.undo()  # a continued fit makes no trial
    resumed, _ = train(dataset, chosen, checkpoint=memory)
    assert torch.equal(whole.gaussians.position, resumed.gaussians.position)
    assert not torch.equal(whole.gaussians.position, closed.gaussians.position)


def test_stopped_fit_goes_on_with_the_metal_that_a_trial_chose(sphere_dataset, camera_ring, monkeypatch):
    dataset, chosen = sphere_dataset(camera_ring(9, 32)), settings("materials=glossy")
    left = lambda start, *_: replace(start, metal=start.gaussians.position[0] < 0)  # noqa: E731
    monkeypatch.setattr("irgspp.core.stages.first.train.select_material_class", lambda *_: SelectedClass(GLOSSY))
    monkeypatch.setattr("irgspp.core.stages.first.train.select_metal", left)
    whole, _ = train(dataset, chosen)
    memory = stopped(dataset, chosen)
    monkeypatch.undo()  # a continued fit makes no trial
    resumed, _ = train(dataset, chosen, checkpoint=memory)
    assert torch.equal(whole.gaussians.material, resumed.gaussians.material)
    metallic = whole.gaussians.materials()[4]
    assert metallic[whole.gaussians.position[0] < -0.1].min() > 0.5 > metallic[whole.gaussians.position[0] > 0.1].max()


@pytest.mark.parametrize(("material_class", "traced_from"), [(GLOSSY, 1.0), (METAL, 1.0), (METAL, 0.1), (GLOSSY, 0.5)])
def test_state_holds_all_that_matters_of_a_reflecting_fit(sphere_dataset, camera_ring, material_class, traced_from):
    """Also where it was stopped after, or before, the first trace of inter-reflections."""
    dataset, chosen = sphere_dataset(camera_ring(9, 32)), settings(f"first.inter_reflections={traced_from}").first
    start = initial_gaussians(dataset, 400, np.random.default_rng(0))
    first, second = (Trainer(dataset, chosen, start, material_class, 0, 9) for _ in range(2))
    for _ in range(12):
        first.step()
    for _ in range(4):
        second.step()
    third = Trainer(dataset, chosen, start, material_class, 0, 9)
    third.restore(second.state())
    for _ in range(8):
        third.step()
    assert torch.equal(first.light, third.light)
    for name, value in first.optimizer.gaussians.tensors().items():
        assert torch.equal(value, third.optimizer.gaussians.tensors()[name]), name


def test_shape_is_offered_before_the_first_step(sphere_dataset, camera_ring):
    shapes = []

    class Watcher(StopAfter):
        def shape(self, sample, at_once=False):
            shapes.append(sample())

        def step(self, done, **figures):
            assert shapes, "the first step comes after its kernels are compiled"
            super().step(done, **figures)

    with pytest.raises(Cancelled):
        train(sphere_dataset(camera_ring(9, 32)), settings(), Watcher(1))
    assert len(shapes[0]["position"]) > 100


def test_fit_gets_better_on_views_it_does_not_learn_from(sphere_dataset, camera_ring):
    dataset, chosen = sphere_dataset(camera_ring(12, 32)), settings("first.iterations=60").first
    trainer = Trainer(dataset, chosen, initial_gaussians(dataset, 400, np.random.default_rng(0)), LOW_GLOSS, 0, 4)
    before = trainer.test()
    for _ in range(60):
        trainer.step()
    after = trainer.test()
    assert before is not None and after is not None and after > before + 3
    assert int(trainer.held_back.sum()) == 3


def test_a_mirror_is_distinguished_from_paint(sphere_dataset, camera_ring):
    cameras = camera_ring(24, 48)
    painted = sphere_dataset(cameras)
    mirror = mirror_photographs(cameras, [view.alpha for view in painted.train])
    chosen = settings("first.trial_iterations=60", "first.trial_gaussians=1500", "first.gaussians=1500")
    start = initial_gaussians(painted, 1500, np.random.default_rng(0))
    painted_class, mirror_class = (select_material_class(data, chosen, start, Silent()) for data in (painted, mirror))
    assert painted_class.material_class is LOW_GLOSS
    assert mirror_class.material_class.split_sum
    assert mirror_class.gloss_gain > painted_class.gloss_gain


def test_what_is_given_is_not_tried(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(9, 32))
    start = initial_gaussians(dataset, 400, np.random.default_rng(0))
    assert select_material_class(dataset, settings("materials=low-gloss"), start, Silent()).material_class is LOW_GLOSS
    assert {m.split_sum for m in allowed_material_classes("glossy")} == {True}
    unmasked = sphere_dataset(camera_ring(9, 32), masked=False)
    selected, gain = select_material_class(unmasked, settings(), start, Silent())
    assert (selected.name, selected.position, gain) == (LOW_GLOSS.name, GLOSSY.position, 0)


def test_subsample_surfels_cover_the_same_area(splat_sphere):
    many = splat_sphere(1000)
    few = subsample(many, 250, 0)
    assert few.count == 250
    assert few.log_scale.exp().square().sum().item() == pytest.approx(many.log_scale.exp().square().sum().item(), rel=1e-4)


def test_background_starts_like_the_borders(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(9, 32), masked=False)
    trainer = Trainer(dataset, settings().first, initial_gaussians(dataset, 400, np.random.default_rng(0)), LOW_GLOSS, 0, 0)
    found = border_radiance(trainer.training_views)
    assert found.tolist() == pytest.approx([((c + 0.055) / 1.055) ** 2.4 for c in (0.8, 0.5, 0.2)], rel=1e-4)
    assert trainer.test() is None


def test_all_four_borders_count(sphere_dataset, camera_ring):
    view = make_training_view(sphere_dataset(camera_ring(1, 32), masked=False).train[0])
    view.image[:] = 0.0
    view.image[:, -1], view.image[:, :, -1], view.image[:, 1:-1, 0] = 1.0, 1.0, 1.0
    assert border_radiance([view]).tolist() == pytest.approx([1, 1, 1])


def test_a_loss_that_is_not_finite_stops_the_fit(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(9, 32))
    trainer = Trainer(dataset, settings().first, initial_gaussians(dataset, 400, np.random.default_rng(0)), LOW_GLOSS, 0, 9)
    trainer.step()
    for view in trainer.training_views:
        view.image.fill_(math.nan)
    with pytest.raises(IrgsppError, match="loss is not finite at iteration 2"):
        trainer.step()


def test_images_that_are_not_finite_are_named_by_what_they_initialise(sphere_dataset, camera_ring):
    dataset = sphere_dataset(camera_ring(9, 32))
    view = replace(dataset.train[0], colour=np.full_like(dataset.train[0].colour, math.nan))
    with pytest.raises(IrgsppError, match="sh_dc is not finite after iteration 0"):
        train(replace(dataset, train=[view] * 9), settings("materials=low-gloss"))


def test_a_cropped_image_has_the_same_gradient(sphere_dataset, camera_ring):
    dataset = sphere_dataset([Camera(96, 96, 60.0, 60.0, 48.0, 48.0, c.to_world) for c in camera_ring(3, 32)])
    start, gradients, losses = initial_gaussians(dataset, 4000, np.random.default_rng(0)), [], []
    for crop in (False, True):
        trainer = Trainer(dataset, settings("first.iterations=60").first, start, LOW_GLOSS, 0, 0, crop=crop)
        trainer.optimizer.step = lambda *_: None
        losses.append(trainer.step())
        gradients.append(trainer.optimizer.leaves["opacity"].grad)
    assert trainer.training_views[0].pixel_fraction < 0.8
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
    assert (gradients[1] - gradients[0]).norm() < 1e-2 * gradients[0].norm()


def test_a_hopeless_material_class_is_given_up_and_others_go_on(sphere_dataset, camera_ring, monkeypatch):
    dataset = sphere_dataset(camera_ring(12, 32))
    start, steps = initial_gaussians(dataset, 400, np.random.default_rng(0)), dict.fromkeys(("low-gloss", "glossy", "metal"), 0)

    def counted(self):
        steps[self.material_class.name] += 1
        return 0.0

    monkeypatch.setattr(Trainer, "step", counted)
    monkeypatch.setattr(Trainer, "test", lambda self: {"low-gloss": 30.0, "glossy": 29.0, "metal": 20.0}[self.material_class.name])
    chosen = settings("first.trial_iterations=10", "first.trial_gaussians=100")
    assert select_material_class(dataset, chosen, start, Silent()).material_class is LOW_GLOSS
    assert steps == {"low-gloss": 10, "glossy": 10, "metal": 3}
    steps |= dict.fromkeys(steps, 0)
    assert select_material_class(dataset, with_overrides(chosen, ["skip.trials=off"]), start, Silent()).material_class is LOW_GLOSS
    assert set(steps.values()) == {10}


def test_a_turning_light_needs_more_evidence_of_gloss(sphere_dataset, camera_ring, monkeypatch):
    dataset = sphere_dataset(camera_ring(12, 32))
    start = initial_gaussians(dataset, 400, np.random.default_rng(0))
    turning = replace(dataset, train=[replace(view, light_rotation=np.eye(3)) for view in dataset.train])
    monkeypatch.setattr(Trainer, "step", lambda self: 0.0)
    chosen = settings("first.trial_iterations=10", "first.trial_gaussians=100")
    for psnr, found in ((31.0, ("glossy", "low-gloss")), (32.0, ("glossy", "glossy"))):
        scores = {"low-gloss": 30.0, "glossy": psnr, "metal": 20.0}
        monkeypatch.setattr(Trainer, "test", lambda self, scores=scores: scores[self.material_class.name])
        selected = [select_material_class(data, chosen, start, Silent()) for data in (dataset, turning)]
        assert tuple(one.material_class.name for one in selected) == found
        assert [one.gloss_gain for one in selected] == [psnr - 30.0] * 2


def test_a_time_sets_the_schedule_which_a_checkpoint_keeps(sphere_dataset, camera_ring, monkeypatch):
    dataset, memory = sphere_dataset(camera_ring(9, 32)), Memory()
    chosen = settings("materials=low-gloss", "first.iterations=20")
    monkeypatch.setattr("irgspp.core.stages.first.train.first_stage_schedule_scale", lambda *_: 2.0)
    with pytest.raises(Cancelled):
        train(dataset, chosen, StopAfter(30), memory, deadline=time.monotonic() + 60)
    assert train(dataset, chosen, checkpoint=memory, deadline=time.monotonic() + 60)[1] == 2.0
    assert memory["first_stage"]["iterations"] == 40


@pytest.mark.parametrize("own_steps", [400, 2000])
def test_surfels_go_slower_in_a_schedule_that_is_longer_than_was_set(sphere_dataset, camera_ring, own_steps):
    dataset = sphere_dataset(camera_ring(3, 32))
    start = initial_gaussians(dataset, 400, np.random.default_rng(0))
    trainer = Trainer(dataset, settings(f"first.iterations={own_steps}").first, start, LOW_GLOSS, 0, 0)
    own, meant = dict(trainer.optimizer.rates), max(own_steps, RATES_CHOSEN_AT)
    for iterations, slower in ((4 * meant, 0.5), (9 * meant, 1 / 3), (meant // 2, 1.0), (meant, 1.0)):
        trainer.reschedule(iterations)
        rates = trainer.optimizer.rates
        moving = {name: rates[name].start / own[name].start for name in GEOMETRY_RATES}
        assert moving == pytest.approx(dict.fromkeys(GEOMETRY_RATES, slower))
        assert {n: r for n, r in rates.items() if n not in GEOMETRY_RATES} == {n: r for n, r in own.items() if n not in GEOMETRY_RATES}


@pytest.mark.parametrize(
    "change",
    [
        lambda s: s.pop("done"),
        lambda s: s.update(done=1.5),
        lambda s: s.update(done=10**6),
        lambda s: s.update(iterations=0),
        lambda s: s.update(order=torch.tensor([9])),
        lambda s: s.update(order=None),
        lambda s: s.update(generator=torch.zeros(3, dtype=torch.uint8)),
        lambda s: s.update(seen=torch.zeros(3)),
        lambda s: s["optimizer"].pop("moments"),
        lambda s: s["optimizer"]["others"].pop("light"),
        lambda s: s["optimizer"]["moments"].update({"light.exp_avg": torch.zeros(2, 2, 3)}),
        lambda s: s["optimizer"]["moments"].update({"sh_rest.exp_avg": torch.zeros(16, 3, 400)}),
        lambda s: s["optimizer"]["moments"].update({"light.step": torch.tensor(math.nan)}),
        lambda s: s["optimizer"]["values"].update(opacity=torch.zeros(399)),
        lambda s: s["optimizer"]["values"].update(opacity=torch.zeros(400, dtype=torch.float64)),
        lambda s: s["optimizer"]["values"].update(position=torch.zeros(400, 3).T),
        lambda s: s.pop("inter_reflections"),
        lambda s: s["inter_reflections"].pop("environment"),
        lambda s: s["inter_reflections"].update(environment=torch.zeros(4, 8, 3)),
        lambda s: s["inter_reflections"].update(opacity=torch.zeros(3)),
        lambda s: s["inter_reflections"].update(sh=s["inter_reflections"]["sh"] * math.nan),
        lambda s: s["inter_reflections"].update(more=torch.zeros(3)),
        lambda s: s["optimizer"].update(values={k: v[..., :0] for k, v in s["optimizer"]["values"].items()}),
    ],
)
def test_state_of_another_fit_is_refused(sphere_dataset, camera_ring, change):
    """Compiled code trusts shapes, and a checkpoint may be any file."""
    dataset = sphere_dataset(camera_ring(9, 32))
    chosen = settings("first.inter_reflections=0").first
    trainer = Trainer(dataset, chosen, initial_gaussians(dataset, 400, np.random.default_rng(0)), GLOSSY, 0, 9)
    trainer.step()
    state = trainer.state()
    trainer.restore(state)
    change(state)
    with pytest.raises(InputError, match="holds no state of this job's first stage"):
        trainer.restore(state)


def test_state_of_an_unknown_material_class_is_refused(sphere_dataset, camera_ring):
    memory = Memory(first_stage={"kind": "wood"})
    with pytest.raises(InputError, match="holds no state"):
        train(sphere_dataset(camera_ring(9, 32)), settings(), checkpoint=memory)


def test_first_part_of_the_schedule_renders_single_rays(sphere_dataset, camera_ring, monkeypatch):
    """Steps use one ray per pixel until `single_rays` of the schedule is done; tests on held-back views never do."""
    dataset, rays = sphere_dataset(camera_ring(8)), []
    original = trainer_module.rasterize
    monkeypatch.setattr(trainer_module, "rasterize", lambda *a: rays.append(a[-1]) or original(*a))
    chosen = settings("first.iterations=5", "first.single_rays=0.4", "first.subpixels=2").first
    trainer = Trainer(dataset, chosen, initial_gaussians(dataset, 400, np.random.default_rng(0)), LOW_GLOSS, 0, 6)
    trainer.test()
    tests = len(rays)
    assert set(rays) == {2}
    for _ in range(5):
        trainer.step()
    assert rays[tests:] == [1, 1, 2, 2, 2]


@pytest.mark.parametrize(("material_class", "scale"), [(LOW_GLOSS, 1), (METAL, 2)])
def test_metal_takes_a_longer_schedule(sphere_dataset, camera_ring, monkeypatch, material_class, scale):
    monkeypatch.setattr("irgspp.core.stages.first.train.select_material_class", lambda *args: SelectedClass(material_class))
    assert train(sphere_dataset(camera_ring(9, 32)), settings("first.iterations=6"))[1] == scale
