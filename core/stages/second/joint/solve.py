# SPDX-License-Identifier: GPL-3.0-or-later
"""Joint optimisation as the second stage, and as the refinement of another solver's result."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import torch

from ....errors import Cancelled, InputError
from ....progress.protocol import Checkpoint, Progress
from ....scene.dataset import Dataset, light_rotations
from ....scene.reconstruction import Reconstruction
from ....settings.schema import Settings
from ....shading.rendering_equation import reflect_light
from ...common.optimizer import Rate
from ...common.preview import albedo_image
from ...common.time_budget import joint_schedule_scale, scale_schedule
from .irgs import irgs_start
from .losses import GLOSSY_WEIGHTS, LOW_GLOSS_WEIGHTS
from .model import JointModel
from .optimisation import PUBLISHED_RATE_FACTOR, JointOptimisation
from .radiance_start import with_all_radiance

CHECKPOINT_SECONDS = 30.0  # between two checkpoints
REFINING_RATE_FACTOR, REFINING_SMOOTHNESS = Rate(0.2, 0.1), 0.1  # factor of the published rates, and weight of materials' smoothness
MIN_GAIN = 0.2  # dB of held-back views; at the published rates a gain of 0.07 dB was measured with a loss of 1.1 dB under other lights
TEST_EVERY = 200  # iterations between tests


def check_joint(dataset: Dataset) -> None:
    """Raise InputError for photographs whose light turns relative to the object: one radiance cannot be its indirect light in all."""
    if light_rotations(dataset.train) is not None:
        what = "the joint optimisation takes indirect light from one radiance, and the light turns with the photographs"
        other = ", or data.light=still" if dataset.lit_from_camera else ""
        raise InputError("second.solver", what, f"use --set second.solver=closed{other}")


def optimise_jointly(
    first: Reconstruction,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    deadline: float | None = None,
    checkpoint: Checkpoint | None = None,
) -> tuple[Reconstruction, float]:
    """Optimise geometry, radiance, materials and light on all training views, as published.

    Args:
        first: result of the first stage.
        dataset: training views.
        settings: settings of the job.
        progress: receives steps, previews and the PSNR of shaded pixels; it may cancel or finish early.
        deadline: seconds on the monotonic clock at which the optimisation is to end; None: the whole schedule.
        checkpoint: storage of the state "joint", from which the optimisation continues where there is one; None for none.

    Returns:
        The reconstruction, and the schedule scale as a multiple of the settings' schedule.

    Raises:
        Cancelled: the user stopped the work; the checkpoint is written.
        InputError: the photographs do not fit, see `check_joint`, or the checkpoint is not one of this job.
        IrgsppError: a value is not finite.
    """
    optimisation, scale, before, after = _optimised(first, dataset, settings, progress, deadline, checkpoint, refining=False)
    progress.message(f"joint optimisation: PSNR of shaded training views {before:.2f} dB, then {after:.2f} dB")
    return optimisation.result(), scale


def refine_jointly(
    solved: Reconstruction,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    deadline: float | None = None,
    checkpoint: Checkpoint | None = None,
) -> tuple[Reconstruction, float]:
    """Optimise another solver's result jointly, and keep what comes out only where it shades held-back views better by MIN_GAIN.

    The published rates and smoothness are made for a start far from the solution. Here they are lower, by REFINING_RATE_FACTOR and
    REFINING_SMOOTHNESS.

    Args:
        solved: result of the closed solver.
        dataset: training views, of which some are held back (`held_back`).
        settings: settings of the job.
        progress: see `optimise_jointly`.
        deadline: see `optimise_jointly`.
        checkpoint: see `optimise_jointly`.

    Returns:
        The better reconstruction, and the schedule scale as a multiple of the settings' schedule.

    Raises:
        Cancelled: the user stopped the work; the checkpoint is written.
        InputError: the photographs do not fit, see `check_joint`, or the checkpoint is not one of this job.
        IrgsppError: a value is not finite.
    """
    optimisation, scale, before, after = _optimised(solved, dataset, settings, progress, deadline, checkpoint, refining=True)
    kept = after > before + MIN_GAIN
    evidence = f"PSNR of shaded held-back views {before:.2f} dB, then {after:.2f} dB"
    progress.decided("joint", kept, evidence)
    progress.message(f"joint optimisation: {evidence}; {'kept' if kept else 'discarded'}")
    return _with_radiance_of(optimisation.result(), solved) if kept else solved, scale


def _with_radiance_of(result: Reconstruction, solved: Reconstruction) -> Reconstruction:
    """Return a result with the own radiance of a start with split-sum: SH alone, as the optimisation needs them, blur its reflections."""
    if not solved.has_split_sum:
        return result
    gaussians = replace(result.gaussians, sh=solved.gaussians.sh)
    return replace(result, gaussians=gaussians, has_split_sum=True, reflections=solved.mirrored())


def _optimised(
    start: Reconstruction,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    deadline: float | None,
    checkpoint: Checkpoint | None,
    *,
    refining: bool,
) -> tuple[JointOptimisation, float, float, float]:
    """Run the optimisation; return it with the schedule scale and the PSNR of shaded views before and after it."""
    check_joint(dataset)
    second, reflects = settings.second, start.has_split_sum
    start = with_all_radiance(start, dataset.train, settings, progress)
    near = dataset.surroundings if second.surroundings and second.indirect else None
    model = JointModel.of(start, near, settings.first.subpixels, second.indirect, second.shadows)
    if second.brdf == "irgs":
        start, model = irgs_start(start), replace(model, reflect=partial(reflect_light, brdf="irgs"))
    model = replace(model, distortion=second.distortion_weight > 0)
    weights = replace(GLOSSY_WEIGHTS if reflects else LOW_GLOSS_WEIGHTS, distortion=second.distortion_weight)
    factor = PUBLISHED_RATE_FACTOR
    if refining:
        smooth = REFINING_SMOOTHNESS
        weights, factor = replace(weights, albedo=smooth, roughness=smooth, metallic=smooth), REFINING_RATE_FACTOR
    views, seed = dataset.train, settings.seed
    optimisation = JointOptimisation(start, views, model, second, seed, weights=weights, factor=factor, hold_back=refining)
    before, iterations = optimisation.test(), optimisation.settings.iterations
    state = None if checkpoint is None else checkpoint.load("joint")
    progress.phase("joint", iterations)
    if state is not None:
        optimisation.restore(state)
        progress.phase("joint", optimisation.settings.iterations)
    elif deadline is not None:
        _scale_to_deadline(optimisation, deadline, progress)
    _run(optimisation, dataset, progress, checkpoint)
    return optimisation, optimisation.settings.iterations / iterations, before, optimisation.test()


def _run(optimisation: JointOptimisation, dataset: Dataset, progress: Progress, checkpoint: Checkpoint | None) -> None:
    """Run the rest of the schedule; write the checkpoint every CHECKPOINT_SECONDS and on cancelling."""
    saved = time.monotonic()

    def report(done: int, loss: float) -> bool:
        """Report an iteration and offer a preview; return True to finish early."""
        nonlocal saved
        metrics = {"loss": loss}
        if done % TEST_EVERY == 0:
            metrics["psnr"] = optimisation.test()
        progress.step(done, **metrics)
        if checkpoint is not None and (progress.cancelled or time.monotonic() - saved > CHECKPOINT_SECONDS):
            checkpoint.save("joint", optimisation.state())
            saved = time.monotonic()
        if progress.cancelled:
            raise Cancelled(f"stopped at iteration {done} of the joint optimisation")
        progress.image(lambda: albedo_image(optimisation.result(), dataset.train[0].camera))
        return progress.finish_early

    optimisation.run(report)


def _scale_to_deadline(optimisation: JointOptimisation, deadline: float, progress: Progress) -> None:
    """Do the first iterations, and scale the schedule so that it ends by the deadline."""
    iterations = optimisation.settings.iterations
    scale_for = lambda left, step: joint_schedule_scale(iterations, left, step)  # noqa: E731
    _, report = scale_schedule(optimisation, "joint optimisation", deadline, scale_for, 1.0)
    progress.phase("joint", optimisation.settings.iterations)
    progress.message(report)


def has_moved(solved: Reconstruction, first: Reconstruction) -> bool:
    """Return True where the joint optimisation has moved the surfels of the first stage, so that their surface has changed.

    Args:
        solved: result of the second stage.
        first: result of the first stage.
    """
    return not torch.equal(solved.gaussians.position, first.gaussians.position)
