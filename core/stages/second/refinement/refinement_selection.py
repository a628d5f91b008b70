# SPDX-License-Identifier: GPL-3.0-or-later
"""Refinement of the most promising start, judged by held-back views."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ....progress.protocol import Progress
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.camera import Camera
from ....scene.dataset import Dataset
from ....scene.reconstruction import Reconstruction
from ....scene.surface import Surface
from ....settings.schema import Settings
from ...common.preview import albedo_image
from ...common.skip_rules import decide_skip_rule
from ...common.time_budget import MAX_SECOND_STAGE_SCALE, scale_schedule, second_stage_schedule_scale
from ..metal import is_all_metal
from ..step_report import report_step
from .material_confidence import with_confidence
from .metal_albedo import with_pooled_metal_albedo
from .pixel_pool import PixelPool, pool_pixels, with_surface_normals
from .refinement import Refinement
from .roughness_pooling import with_pooled_roughness

MAX_CACHED_MEGABYTES = 2000  # largest size of the hit lists of the pixel pool
METAL_STEPS_FACTOR = 1.5  # length of a metal's schedule; on two scenes, new views gain 0.1 dB and relit images 0.03 to 0.09 dB
# dB of held-back views by which a refinement may be worse: they are few, and err by as much. On igea_relief they changed by -.02 to +.8 dB
# with slightly different schedules and weights, all of which improved relit images by .1 dB and new views by .3 to .4 dB.
MAX_LOSS = 0.2
TRIAL_SHARE = 0.2  # share of the schedule after which one of several starts is chosen; before it, the better start often looks worse


def refine(
    starts: Sequence[Reconstruction],
    dataset: Dataset,
    tracer: SecondaryTracer,
    settings: Settings,
    progress: Progress,
    deadline: float | None,
    surface: Surface | None = None,
) -> tuple[Reconstruction, float]:
    """Refine each start for a short time, and the best of them to the end.

    Args:
        starts: reconstructions with the same geometry.
        dataset: training views.
        tracer: tracer of the Gaussians.
        settings: settings of the job.
        progress: receives steps and previews, and may cancel.
        deadline: seconds on the monotonic clock, None for none.
        surface: surface whose normals pixels are shaded by, beside those of the surfels; None for none.

    Returns:
        The refined reconstruction, or its start where refinement makes the held-back views worse by more than MAX_LOSS, with the
        confidence of its materials and a roughness that is pooled by it; or the first start where nothing is to be refined; and the
        schedule scale.

    Raises:
        Cancelled: the user stopped the work.
    """
    if settings.second.iterations == 0:
        return starts[0], 1.0
    if is_all_metal(starts[0].gaussians):
        settings = replace(settings, second=replace(settings.second, iterations=round(METAL_STEPS_FACTOR * settings.second.iterations)))
    progress.phase("refine", settings.second.iterations)
    pool = pool_pixels(dataset.train, tracer, settings.second.pool, np.random.default_rng(settings.seed), settings.first.subpixels)
    if not pool.count:
        progress.message("not refined: no pixel shows the object alone")
        return starts[0], 1.0
    cameras = [view.camera for view in dataset.train]
    pool = pool if surface is None else with_surface_normals(pool, surface, cameras)
    refinements = prepare_refinements(starts, pool, tracer, cameras, settings, progress)
    before = [refinement.test() for refinement in refinements]
    schedule_scale = 1.0 if deadline is None else _scale_to_deadline(refinements, dataset, settings, deadline, progress)
    best = _best_after_trial(refinements, progress)

    def report(done: int) -> bool:
        """Report a step and offer a preview; return True to finish early."""
        report_step(progress, done)
        progress.image(lambda: albedo_image(best.result(), dataset.train[0].camera))
        return progress.finish_early

    best.run(report)
    after, first = best.test(), before[refinements.index(best)]
    progress.message(f"PSNR of shaded held-back views: {', '.join(f'{b:.2f}' for b in before)} dB, refined {after:.2f} dB")
    return _by_confidence(best.result() if after > first - MAX_LOSS else best.start, pool, tracer, settings), schedule_scale


def _by_confidence(result: Reconstruction, pool: PixelPool, tracer: SecondaryTracer, settings: Settings) -> Reconstruction:
    """Return a refined reconstruction with the confidence of its materials, roughness pooled by it, and pooled albedo of metal."""
    known = with_confidence(result, pool, tracer, settings.second, settings.seed)
    if is_all_metal(known.gaussians):  # its materials make up for wrong normals: new views of a teapot lost 1 dB, relit ones .4
        return known
    return with_pooled_metal_albedo(with_pooled_roughness(known, settings.seed), settings.seed)


def prepare_refinements(
    starts: Sequence[Reconstruction],
    pool: PixelPool,
    tracer: SecondaryTracer,
    cameras: Sequence[Camera],
    settings: Settings,
    progress: Progress,
) -> list[Refinement]:
    """Prepare a refinement for each start, and decide the skip rule "cache_hits".

    Args:
        starts: reconstructions with the same geometry.
        pool: pixels of the training views.
        tracer: tracer of the Gaussians.
        cameras: cameras of the training views, which are rasterised anew in each step where the rule is off.
        settings: settings of the job.
        progress: receives the decision.
    """
    megabytes = len(pool.lists.index) * 12 / 1e6
    evidence = f"the surfels of {pool.count:,} pixels take {megabytes:.0f} MB"
    cache_hits = decide_skip_rule(settings.skip, "cache_hits", megabytes < MAX_CACHED_MEGABYTES, evidence, progress)
    tracer.repack = not cache_hits
    cameras = () if cache_hits else cameras
    return [Refinement(start, pool, tracer, settings.second, settings.seed, cameras=cameras) for start in starts]


def _best_after_trial(refinements: Sequence[Refinement], progress: Progress) -> Refinement:
    """Refine each for the share TRIAL_SHARE of the schedule, if there are several; return the best on held-back views."""
    if len(refinements) == 1:
        return refinements[0]
    for refinement in refinements:
        refinement.run(_until(int(TRIAL_SHARE * refinement.settings.iterations), progress))
    return max(refinements, key=lambda refinement: refinement.test())


def _until(steps: int, progress: Progress) -> Callable[[int], bool]:
    """Return a callback that reports each step and ends the run after a number of steps, or earlier where the user asks for it."""

    def report(done: int) -> bool:
        return report_step(progress, done) or done >= steps

    return report


def _scale_to_deadline(
    refinements: Sequence[Refinement], dataset: Dataset, settings: Settings, deadline: float, progress: Progress
) -> float:
    """Do the first steps of one, and scale the schedules so that all end by the deadline; returns the schedule scale."""
    now = time.monotonic()
    alone = now + (deadline - now) / (1 + TRIAL_SHARE * (len(refinements) - 1))
    scale_for = lambda left, step: second_stage_schedule_scale(settings, dataset, left, step)  # noqa: E731
    schedule_scale, report = scale_schedule(refinements[0], "second stage", alone, scale_for, MAX_SECOND_STAGE_SCALE)
    for refinement in refinements[1:]:
        refinement.reschedule(refinements[0].settings.iterations)
    progress.phase("refine", refinements[0].settings.iterations)
    progress.message(report)
    return schedule_scale
