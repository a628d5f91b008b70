# SPDX-License-Identifier: GPL-3.0-or-later
"""First stage: 2D Gaussians with radiance and, for glossy objects, split-sum reflections, from the training images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ...machine.backend import incomplete_images
from ...progress.protocol import Checkpoint, Progress, Silent
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...scene.reconstruction import Reconstruction
from ...settings.schema import Settings
from ..common.preview import points_shape
from ..common.skip_rules import decide_skip_rule
from ..common.time_budget import first_stage_largest_scale, first_stage_schedule_scale, scale_schedule, scaled_iterations
from ..common.training_view import object_box
from .edge_selection import select_open_edges
from .initial_light_albedo import estimate_light_albedo
from .initialization import initial_gaussians
from .material_class import MaterialClass
from .material_class_selection import material_class_named, select_material_class
from .metal_selection import select_metal
from .mirror_selection import select_mirrors
from .schedule import densifies
from .sphere_selection import select_spheres
from .start import Start
from .start_selection import select_start
from .start_trials import StartTrials
from .trainer import Trainer
from .trial_fits import MIN_HOLD_BACK_VIEWS

MAX_CROP_FRACTION = 0.9  # mean fraction of the images inside the object's box below which cropping saves time


def decide_cropping(dataset: Dataset, settings: Settings, progress: Progress) -> bool:
    """Decide whether images are cropped to the object: pixels that are black in image and rendering give no gradient.

    Args:
        dataset: training views.
        settings: settings of the job; the skip rule "background" is read.
        progress: receives the decision.
    """
    if not dataset.has_alpha:
        progress.decided("background", False, "without masks all pixels count")
        return False
    alphas = [torch.from_numpy(view.alpha) for view in dataset.train if view.alpha is not None]
    fraction = float(np.mean([alpha[object_box(alpha)].numel() / alpha.numel() for alpha in alphas]))
    evidence = f"the object's surroundings are {1 - fraction:.0%} of the pixels"
    return decide_skip_rule(settings.skip, "background", fraction < MAX_CROP_FRACTION, evidence, progress)


def train(
    dataset: Dataset,
    settings: Settings,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    deadline: float | None = None,
    device: torch.device | str = "cpu",
    resident: bool = True,
) -> tuple[Reconstruction, float]:
    """Fit Gaussians to the training views.

    Args:
        dataset: views.
        settings: settings of the job, with the number of Gaussians that suits the dataset (`with_sizes`).
        progress: receives the progress and may cancel; None for neither.
        checkpoint: storage of intermediate states. The fit continues from the state "first_stage" where there is one; the result is
            then that of an uninterrupted run.
        deadline: end of the whole job in seconds on the monotonic clock, to which schedules are scaled by the duration of the first
            steps; None: schedules as in the settings.
        device: device that the optimisation runs on.
        resident: keep the training images on the device.

    Returns:
        The reconstruction on the CPU, and the schedule scale as a multiple of the settings' schedule.

    Raises:
        Cancelled: the user stopped the work; the checkpoint is written.
        InputError: the checkpoint is not one of this job.
        IrgsppError: a value is not finite, or no Gaussian is left.
    """
    progress = progress or Silent()
    torch.manual_seed(settings.seed)
    begun = _at_start(settings, dataset.has_alpha)
    gaussians = initial_gaussians(dataset, begun.first.gaussians, np.random.default_rng(settings.seed)).to(device)
    state = checkpoint.load("first_stage") if checkpoint is not None else None
    crop = decide_cropping(dataset, settings, progress)
    if state is not None:
        material_class, start = material_class_named(state.get("kind", ""), dataset), Start(gaussians)
    else:
        progress.shape(lambda: points_shape(gaussians, dataset))  # before the kernels are compiled, which may take half a minute
        material_class, start, open_edges = _selected(dataset, begun, gaussians, progress, crop)
        settings = replace(settings, first=replace(settings.first, open_edges=open_edges))
    # A deadline tells the length of the schedule.
    schedule = scaled_iterations(1.0 if deadline is not None else material_class.schedule, settings.first.iterations)
    trainer = _trainer(dataset, settings, schedule, start, material_class, crop=crop, resident=resident)
    if state is not None:
        trainer.restore(state)
    elif deadline is not None:
        _scale_to_deadline(trainer, dataset, settings, deadline, progress)
    progress.phase("first stage", trainer.settings.iterations)
    before = incomplete_images()
    trainer.run(progress, checkpoint)
    _report_run(trainer, incomplete_images() - before, progress)
    result = estimate_light_albedo(trainer.reconstruction().to("cpu"), settings.seed, dataset.train)
    return result, trainer.settings.iterations / settings.first.iterations


def _selected(
    dataset: Dataset, settings: Settings, gaussians: Gaussians, progress: Progress, crop: bool
) -> tuple[MaterialClass, Start, float]:
    """Return what trial fits select: the material class, the start, and the part of the schedule in which edges are open."""
    material_class, gloss_gain = select_material_class(dataset, settings, gaussians, progress, crop)
    trials = StartTrials(dataset, settings, material_class, crop, gloss_gain)
    start = select_start(gaussians, trials, progress)
    start = select_metal(start, trials, progress)
    start = select_spheres(start, trials, progress)
    start = select_mirrors(start, trials, progress)
    return material_class, start, select_open_edges(start, trials, progress)


def _at_start(settings: Settings, masked: bool) -> Settings:
    """Return settings with the number of Gaussians at the start: on a hull half of the budget where density control adds the rest."""
    few = settings.first.gaussians // 2 if masked and densifies(settings.first, masked) else settings.first.gaussians
    return replace(settings, first=replace(settings.first, gaussians=few))


def _trainer(
    dataset: Dataset, settings: Settings, iterations: int, start: Start, material_class: MaterialClass, *, crop: bool, resident: bool
) -> Trainer:
    """Return the trainer of a schedule of so many steps, from which one view is held back where there are enough."""
    return Trainer(
        dataset,
        replace(settings.first, iterations=iterations),
        start.gaussians,
        material_class,
        settings.seed,
        hold_back=len(dataset.train) if len(dataset.train) >= MIN_HOLD_BACK_VIEWS else 0,
        crop=crop,
        resident=resident,
        anchors=start.anchors,
        metal=start.metal,
    )


def _report_run(trainer: Trainer, incomplete: int, progress: Progress) -> None:
    """Report `incomplete` images, and depths that were held at stereo's."""
    if incomplete:
        progress.message(f"warning: in {incomplete} steps the image lacked some surfels, as more were visible than the GPU's buffers hold")
    if trainer.anchors is not None and trainer.anchors.chosen and len(trainer.anchors.pixel):
        kept = len(trainer.anchors.pixel)
        progress.message(f"{kept:,} depths are held at stereo's, where it fits the photographs better than the surfels")


def _scale_to_deadline(trainer: Trainer, dataset: Dataset, settings: Settings, deadline: float, progress: Progress) -> None:
    """Do the first steps, and scale the schedule so that the whole job ends by the deadline."""
    scale_for = lambda left, step: first_stage_schedule_scale(settings, dataset, left, step)  # noqa: E731
    largest = first_stage_largest_scale(settings.first.iterations)
    _, report = scale_schedule(trainer, "first stage", deadline, scale_for, largest)
    progress.message(report)
