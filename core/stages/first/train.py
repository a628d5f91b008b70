# SPDX-License-Identifier: GPL-3.0-or-later
"""The first stage: 2D Gaussians, their radiance and, where the object is glossy, reflections of a split-sum light."""

from __future__ import annotations

import time

import numpy as np
import torch

from ...machine.backend import incomplete_images, wait_for
from ...progress.protocol import Checkpoint, Progress, Silent
from ...scene.dataset import Dataset
from ...scene.reconstruction import Reconstruction
from ...settings.schema import Settings
from ..common.skip_rules import decide
from ..common.time_budget import first_longest, first_schedule_scale, seconds_a_step, times
from ..common.training_view import object_box
from .initial_light_albedo import estimate_light_albedo
from .initialization import initial_gaussians
from .material_class_selection import HOLD_BACK_FROM, material_class_named, select_material_class
from .trainer import Trainer

CUT_BELOW = 0.9  # share of the images around the object from which cutting them pays


def surroundings(dataset: Dataset, settings: Settings, progress: Progress) -> bool:
    """True where images are to be cut to the object: what is black in photograph and rendering teaches nothing."""
    if not dataset.has_alpha:
        progress.decided("background", False, "without masks all pixels count")
        return False
    alphas = [torch.from_numpy(view.alpha) for view in dataset.train if view.alpha is not None]
    share = float(np.mean([alpha[object_box(alpha)].numel() / alpha.numel() for alpha in alphas]))
    return decide(settings.skip, "background", share < CUT_BELOW, f"the object's surroundings are {1 - share:.0%} of the pixels", progress)


def train(
    dataset: Dataset,
    settings: Settings,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    ends: float | None = None,
    device: torch.device | str = "cpu",
    resident: bool = True,
) -> tuple[Reconstruction, float]:
    """Fit Gaussians to the training views on a device. Returns them on the CPU, and how many times as long as set schedules are to be.

    Goes on from the checkpoint "first stage" where there is one; the result is then that of an undisturbed run. `ends`: when the whole
    job is to be done, in seconds of the monotonic clock; schedules follow from the time that the first steps take. `resident`: whether
    the photographs are kept on the device.

    Raises:
        Cancelled: the user stopped the work; the checkpoint is written. IrgsppError: the loss is not finite, or no Gaussian is left.
    """
    progress = progress or Silent()
    torch.manual_seed(settings.seed)
    gaussians = initial_gaussians(dataset, settings.first.gaussians, np.random.default_rng(settings.seed)).to(device)
    state = checkpoint.load("first_stage") if checkpoint is not None else None
    cut = surroundings(dataset, settings, progress)
    kind = (
        material_class_named(state.get("kind", ""), dataset)
        if state is not None
        else select_material_class(dataset, settings, gaussians, progress, cut)
    )
    hold_back = len(dataset.train) if len(dataset.train) >= HOLD_BACK_FROM else 0  # one view
    trainer = Trainer(dataset, settings.first, gaussians, kind, settings.seed, hold_back, cut=cut, resident=resident)
    if state is not None:
        trainer.restore(state)
    elif ends is not None:
        _set_pace(trainer, ends, progress)
    progress.phase("first stage", trainer.settings.iterations)
    before = incomplete_images()
    trainer.run(progress, checkpoint)
    if lacking := incomplete_images() - before:
        progress.message(
            f"warning: {lacking} steps saw images that lacked some surfels: more came into view at once than there was room for"
        )
    trainer.optimizer.check_finite()
    fitted = trainer.optimizer.gaussians.select(torch.arange(trainer.optimizer.gaussians.count))
    background = None if trainer.masked else trainer.background.detach().exp()
    result = Reconstruction(fitted, trainer.light.detach().exp(), dataset.bound, dataset.to_world, kind.glossy, background)
    return estimate_light_albedo(result.to("cpu"), settings.seed), trainer.settings.iterations / settings.first.iterations


def _set_pace(trainer: Trainer, ends: float, progress: Progress) -> None:
    """Do the first steps, and make the schedule as long as what is left of the time allows."""
    step = seconds_a_step(lambda: (trainer.step(), wait_for(trainer.device)))
    left, iterations = ends - time.monotonic(), trainer.settings.iterations
    pace = first_schedule_scale(iterations, left, trainer.kind.glossy, step)
    trainer.paced(times(pace, iterations))
    longest = ", the most that helps" if pace == first_longest(iterations) else ""
    progress.message(f"{left:.0f} s left at {1000 * step:.0f} ms a step: the first stage is {pace:.2f} times the preset's{longest}")
