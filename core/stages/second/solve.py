# SPDX-License-Identifier: GPL-3.0-or-later
"""The second stage: materials and light by the rendering equation, with visibility and indirect light traced through the Gaussians."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import KDTree

from ...errors import Cancelled, IrgsppError
from ...machine.backend import wait_for
from ...progress.protocol import Progress
from ...rendering.secondary_rays import SecondaryTracer
from ...scene.camera import Camera
from ...scene.dataset import Dataset
from ...scene.reconstruction import Reconstruction
from ...scene.surface import Surface
from ...settings.schema import Settings
from ..common.finite_check import require_finite
from ..common.preview import albedo_image
from ..common.skip_rules import decide
from ..common.time_budget import SECOND_LONGEST, second_schedule_scale, seconds_a_step, times
from .gaussian_materials import assign_materials, either_metal_or_not
from .light_material_solver import METALLIC, STEPS, LightMaterialSolver
from .multi_view_samples import MultiViewSamples, observe
from .normal_alignment import turned
from .pixel_pool import PixelPool, pool_pixels
from .radiance_refit import refit_radiance
from .radiance_transfer import RadianceTransfer, trace_radiance_transfer
from .refinement import MOSTLY_METAL, Refinement, is_metal

LEAST_POINTS = 50  # fewer say nothing about a light
KEPT_MEGABYTES = 2000  # of pixels' surfels at hand
SIDE = 2  # rays through each texel of the light, along a side


def solve_second_stage(
    reconstruction: Reconstruction,
    surface: Surface,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    ends: float | None = None,
) -> tuple[Reconstruction, float]:
    """Tell light and material apart: materials and light are new, surfels turn a little, and their radiance is fitted again to that.

    Positions, sizes and opacities stay what they are. `ends`: when to be done, in seconds of the monotonic clock. Also returns how
    many times as long as the settings have them schedules were.

    Raises:
        Cancelled: the user stopped the work. IrgsppError: too little of the surface is seen, or something is not finite.
    """
    share = settings.second.mesh_normals
    # A metal's own normals were found by what they reflect, which tells them better than smooth depth does.
    if share > 0 and not is_metal(reconstruction.gaussians):
        reconstruction = replace(reconstruction, gaussians=turned(reconstruction.gaussians, surface, share))
    solver, tracer = solve_light_materials(reconstruction, surface, dataset, settings, progress)
    progress.phase("paint", 100)
    watch = (settings.seed, lambda share: _step(progress, int(100 * share)))
    materials = assign_materials(reconstruction, surface, dataset.train, tracer, solver, *watch)
    light = solver.light.T.reshape(1, 3, solver.transfer.height, -1)
    height = max(settings.second.light_height, solver.transfer.height)
    enlarged = torch.nn.functional.interpolate(light, size=(height, 2 * height), mode="bilinear")[0].permute(1, 2, 0).contiguous()
    require_finite({"a material": materials, "the light": enlarged}, "at the end of the second stage")
    told_apart = reconstruction.relabelled(torch.logit(materials), enlarged)
    result, pace = refined(told_apart, reconstruction, dataset, tracer, solver, settings, progress, ends)
    iterations = times(pace, settings.second.radiance_iterations)
    if iterations:
        progress.phase("radiance", iterations)
        watched = (settings.seed, lambda done: _step(progress, done) or progress.finish_early)
        result = refit_radiance(result, dataset.train, iterations, *watched)
    return result, pace


def refined(
    told_apart: Reconstruction,
    first: Reconstruction,
    dataset: Dataset,
    tracer: SecondaryTracer,
    solver: LightMaterialSolver,
    settings: Settings,
    progress: Progress,
    ends: float | None,
) -> tuple[Reconstruction, float]:
    """The better start, judged by views held back, after gradient descent; without it where that did not serve them. And its pace."""
    if settings.second.iterations == 0:
        return told_apart, 1.0
    progress.phase("refine", settings.second.iterations)
    pool = pool_pixels(dataset.train, tracer, settings.second.pool, np.random.default_rng(settings.seed))
    if not pool.count:
        progress.message("not refined: no pixel shows the object alone")
        return told_apart, 1.0
    starts = [told_apart]
    if first.glossy and float(solver.metallic.mean()) > MOSTLY_METAL:
        starts.append(first.relabelled(either_metal_or_not(first.gaussians), first.environment))
    trials = prepared(starts, pool, tracer, [view.camera for view in dataset.train], settings, progress)
    before = [trial.test() for trial in trials]
    best = int(np.argmax(before))

    def stepped(done: int) -> bool:
        _step(progress, done)
        progress.image(lambda: albedo_image(trials[best].result(), dataset.train[0].camera))
        return progress.finish_early

    pace = 1.0 if ends is None else _set_pace(trials[best], ends, progress)
    trials[best].run(stepped)
    after = trials[best].test()
    progress.message(f"shaded views held back: {', '.join(f'{b:.2f}' for b in before)} dB, refined {after:.2f} dB")
    return trials[best].result() if after > before[best] else starts[best], pace


def _set_pace(refinement: Refinement, ends: float, progress: Progress) -> float:
    """Do the first steps, and make the schedule as long as what is left of the time allows; how many times the preset's that is."""
    step = seconds_a_step(lambda: (refinement.step(), wait_for(refinement.light.device)))
    left, iterations = ends - time.monotonic(), refinement.settings.iterations
    pace = second_schedule_scale(refinement.settings, left, refinement.start.glossy, step)
    refinement.paced(times(pace, iterations))
    progress.phase("refine", refinement.settings.iterations)
    longest = ", the most that helps" if pace == SECOND_LONGEST else ""
    progress.message(f"{left:.0f} s left at {1000 * step:.0f} ms a step: the second stage is {pace:.2f} times the preset's{longest}")
    return pace


def prepared(
    starts: Sequence[Reconstruction],
    pool: PixelPool,
    tracer: SecondaryTracer,
    cameras: Sequence[Camera],
    settings: Settings,
    progress: Progress,
) -> list[Refinement]:
    """The refinement of each start, without the work that this scene does not need."""
    megabytes = len(pool.lists.index) * 12 / 1e6
    evidence = f"the surfels of {pool.count:,} pixels take {megabytes:.0f} MB"
    constants = decide(settings.skip, "cache_hits", megabytes < KEPT_MEGABYTES, evidence, progress)
    tracer.repack = not constants
    cameras = () if constants else cameras
    return [Refinement(start, pool, tracer, settings.second, settings.seed, cameras=cameras) for start in starts]


def solve_light_materials(
    reconstruction: Reconstruction, surface: Surface, dataset: Dataset, settings: Settings, progress: Progress
) -> tuple[LightMaterialSolver, SecondaryTracer]:
    """Light, and materials at single points of the surface."""
    transport, random = settings.second, np.random.default_rng(settings.seed)
    tracer = SecondaryTracer(reconstruction)
    position, normal = surface.samples(transport.points, random)
    seen, _ = observe(position, normal, dataset.train, tracer.tree, tracer.offset, random, transport.views, device=tracer.device)
    if len(seen.position) < LEAST_POINTS:
        raise IrgsppError(
            f"only {len(seen.position)} points of the surface are seen by three photographs: materials can't be told from light"
        )
    progress.phase("trace", len(seen.position))
    how = (transport.rows, SIDE, settings.seed, transport.indirect)
    transfer = trace_radiance_transfer(seen.position, seen.normal, tracer, *how, lambda done: _step(progress, done))
    require_finite({"what shines on the surface": transfer.indirect, "a photograph": seen.colour}, "before the second stage")
    # Without masks the surroundings, which are no distant light, would pass for reflections on metal.
    metals = METALLIC if dataset.has_alpha or reconstruction.glossy else METALLIC[:1]
    solver = _separation(reconstruction, seen, transfer, metals, settings.seed, progress)
    if not reconstruction.glossy and float(solver.metallic.mean()) > MOSTLY_METAL:
        progress.message("found to be metal, though the first stage saw no reflections: done again with none of it metal")
        solver = _separation(reconstruction, seen, transfer, METALLIC[:1], settings.seed, progress)
    return solver, tracer


def _separation(
    reconstruction: Reconstruction,
    seen: MultiViewSamples,
    transfer: RadianceTransfer,
    metals: Sequence[float],
    seed: int,
    progress: Progress,
) -> LightMaterialSolver:
    """Started from the first stage and run to its end; `metals` are the values of metallic that are tried."""
    g = reconstruction.gaussians
    _, nearest = KDTree(g.position.T.cpu().numpy()).query(seen.position.cpu().numpy())
    roughness, metallic = g.materials()[3:, torch.from_numpy(np.asarray(nearest)).to(g.position.device)]
    solver = LightMaterialSolver(seen, transfer, roughness, (metallic > 0.5).float(), seed, metals)
    progress.phase("second stage", STEPS)
    solver.run(lambda done: _step(progress, done) or progress.finish_early)
    progress.message(f"light and materials explain the photographs to {solver.error():.4f} (median difference, encoded)")
    return solver


def _step(progress: Progress, done: int) -> None:
    progress.step(done)
    if progress.cancelled:
        raise Cancelled("stopped in the second stage")
