# SPDX-License-Identifier: GPL-3.0-or-later
"""Second stage: environment light and materials by the rendering equation, with visibility and indirect light traced through Gaussians.

The closed steps, in order: surfels are aligned with the surface (`normals/`), light and materials are solved for points of it (`solver/`),
normals follow the shading (`normals/`), materials go to the Gaussians (`solver/`), are refined on single pixels (`refinement/`), and the
radiance is fitted again. `joint/` holds the joint optimisation, which replaces or refines them.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from ...errors import IrgsppError
from ...progress.protocol import Checkpoint, Progress
from ...rendering.secondary_rays import SecondaryTracer
from ...scene.dataset import Dataset, light_rotations
from ...scene.reconstruction import Reconstruction
from ...scene.surface import Surface
from ...settings.schema import Settings
from ...surface.extraction import coarser
from ..common.finite_check import require_finite
from ..common.nearest_neighbours import nearest_neighbours
from ..common.time_budget import scaled_iterations
from .joint.solve import optimise_jointly, refine_jointly
from .metal import METALLIC_THRESHOLD, is_mostly_metal
from .normals.normal_alignment import align_normals
from .normals.normal_improvement import improve_normals
from .radiance_refit import refit_radiance
from .refinement.refinement_selection import refine
from .secondary_tracer import secondary_tracer
from .solver.albedo_prior import MEDIUM
from .solver.gaussian_materials import assign_materials
from .solver.light_material_solver import STEPS, LightMaterialSolver
from .solver.light_texels import LightTexels
from .solver.metal_starts import metal_starts
from .solver.multi_view_samples import MultiViewSamples, sample_views
from .solver.radiance_transfer import RadianceTransfer
from .solver.schedule import run_solver
from .solver.transfer_tracing import split_brightest, trace_radiance_transfer
from .step_report import report_step

LEAST_POINTS = 50  # with which the light is solved
CLOSED_FRACTION = 0.5  # of the time that is left, for the closed solver where the joint optimisation refines its result
# Share of the error that metal must explain in the test of its regions where the whole object is to be metal; else the solver runs once
# more without metal. teapot_glossy .69, two metal Suzannes .55 and .33; a resin skull under the camera's flash .18.
CLEAR = 0.4
# Share of the final error of the solver without metal that the one with metal must explain, for its result to be taken: two metal Suzannes
# .35 and .28, the skull .12.
DECISIVE = 0.2
SOLVED = 40_000  # triangles of the surface whose points light and materials are solved for, at most
SIDE = 2  # rays through each texel of the light along a side


def solve_second_stage(
    reconstruction: Reconstruction,
    surface: Surface,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    deadline: float | None = None,
    checkpoint: Checkpoint | None = None,
) -> tuple[Reconstruction, float]:
    """Solve for materials and environment light by the solver of the settings.

    Args:
        reconstruction: result of the first stage.
        surface: fused from its depth.
        dataset: training views.
        settings: settings of the job.
        progress: receives the progress and may cancel.
        deadline: seconds on the monotonic clock at which this stage is to end, to which its schedules are scaled; None: schedules as in
            the settings.
        checkpoint: storage of the joint optimisation's state; None for none.

    Returns:
        The reconstruction, and the schedule scale as a multiple of the settings' schedules.

    Raises:
        Cancelled: the user stopped the work.
        InputError: the photographs do not fit the solver.
        IrgsppError: too few points of the surface are seen, or a value is not finite.
    """
    solver = settings.second.solver
    if solver == "joint":
        return optimise_jointly(reconstruction, dataset, settings, progress, deadline, checkpoint)
    if solver == "closed":
        return solve_in_closed_form(reconstruction, surface, dataset, settings, progress, deadline)
    now = time.monotonic()
    middle = None if deadline is None else now + CLOSED_FRACTION * (deadline - now)
    solved, _ = solve_in_closed_form(reconstruction, surface, dataset, settings, progress, middle)
    return refine_jointly(solved, dataset, settings, progress, deadline, checkpoint)


def solve_in_closed_form(
    reconstruction: Reconstruction,
    surface: Surface,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    deadline: float | None = None,
) -> tuple[Reconstruction, float]:
    """Solve for materials and environment light, align the surfels' normals, and fit the radiance again to them.

    Positions, scales and opacities do not change. See `solve_second_stage`.

    Args:
        reconstruction: result of the first stage.
        surface: fused from its depth.
        dataset: training views.
        settings: settings of the job.
        progress: receives the progress and may cancel.
        deadline: see `solve_second_stage`.

    Returns:
        The reconstruction, and the schedule scale as a multiple of the settings' schedules.
    """
    fraction = settings.second.mesh_normals
    # Reflections in the first stage determine a metal's normals better than smooth depth does.
    if fraction > 0 and not is_mostly_metal(reconstruction.gaussians):
        reconstruction = replace(reconstruction, gaussians=align_normals(reconstruction.gaussians, surface, fraction))
    # The noise of a finer mesh's normals hides metal: on capture_ogre, albedo loses 1 dB with 70,000 triangles.
    solver, tracer = solve_light_materials(reconstruction, coarser(surface, SOLVED), dataset, settings, progress)
    if not _is_metal(reconstruction, solver):
        on_step = partial(report_step, progress)
        reconstruction, surface = improve_normals(reconstruction, surface, solver, tracer, dataset, settings, progress, on_step)
        tracer = secondary_tracer(reconstruction, dataset, settings.second)  # turned surfels cover other pixels
    progress.phase("paint", 100)
    materials = assign_materials(
        reconstruction,
        surface,
        dataset.train,
        tracer,
        solver,
        seed=settings.seed,
        on_fraction=lambda fraction: report_step(progress, int(100 * fraction)),
        subpixels=settings.first.subpixels,
    )
    enlarged = solver.light_map(settings.second.light_height)
    require_finite({"a material": materials, "the light": enlarged}, "at the end of the second stage")
    starts = [reconstruction.relabelled(torch.logit(materials), enlarged)]
    if reconstruction.has_split_sum and solver.is_mostly_metal:
        starts = metal_starts(reconstruction, starts[0], solver)
    result, schedule_scale = refine(starts, dataset, tracer, settings, progress, deadline)
    iterations = scaled_iterations(schedule_scale, settings.second.radiance_iterations)
    if iterations:
        progress.phase("radiance", iterations)
        result = refit_radiance(
            result,
            dataset.train,
            iterations,
            seed=settings.seed,
            on_step=partial(report_step, progress),
            subpixels=settings.first.subpixels,
        )
    return result, schedule_scale


def _is_metal(reconstruction: Reconstruction, solver: LightMaterialSolver) -> bool:
    """Return True where the first stage or the solver takes the object for metal, which has no diffuse shading."""
    return is_mostly_metal(reconstruction.gaussians) or solver.is_mostly_metal


def solve_light_materials(
    reconstruction: Reconstruction, surface: Surface, dataset: Dataset, settings: Settings, progress: Progress
) -> tuple[LightMaterialSolver, SecondaryTracer]:
    """Solve for the light and the materials of points of the surface.

    Args:
        reconstruction: result of the first stage with aligned normals.
        surface: mesh on which the points are sampled.
        dataset: training views.
        settings: settings of the job.
        progress: receives the progress and may cancel.

    Returns:
        The solver with its results, and the tracer of the Gaussians.

    Raises:
        Cancelled: the user stopped the work.
        IrgsppError: too few points are seen, or a value is not finite.
    """
    second, random = settings.second, np.random.default_rng(settings.seed)
    tracer = secondary_tracer(reconstruction, dataset, second)
    turns = light_rotations(dataset.train)
    rotations = None if turns is None else torch.from_numpy(turns).to(tracer.device)
    position, normal = surface.samples(second.points, random)
    samples, _ = sample_views(position, normal, dataset.train, tracer, random, most=second.views)
    if len(samples.position) < LEAST_POINTS:
        raise IrgsppError(
            f"only {len(samples.position)} points of the surface are seen in three photographs, too few to separate materials from light; "
            "check that cameras and masks match, or add photographs that overlap more"
        )
    progress.phase("trace", len(samples.position))
    transfer = trace_radiance_transfer(
        samples.position,
        samples.normal,
        tracer,
        LightTexels.uniform(second.rows),
        side=SIDE,
        seed=settings.seed,
        indirect=second.indirect,
        on_step=partial(report_step, progress),
        rotations=rotations,
    )
    require_finite({"the indirect light": transfer.indirect, "a photograph": samples.colour}, "before the second stage")
    # Without masks the surroundings, which are not a distant light, would be taken for reflections on metal, or on a dark object.
    search_metal = dataset.has_alpha or reconstruction.has_split_sum
    solve = partial(_solve_from_first_stage, reconstruction, samples, transfer, tracer, settings, progress)
    solver = solve(search_metal)
    if _is_doubtful_metal(reconstruction, solver):
        progress.message("the solver takes the whole object for metal, but the first stage does not: solved again without metal")
        solver = _decided(solver, solve(False), reconstruction.has_split_sum, progress)
    return solver, tracer


def _is_doubtful_metal(reconstruction: Reconstruction, solver: LightMaterialSolver) -> bool:
    """Return True for an object that the solver alone takes for metal, without the clear evidence that metal gives.

    A flash on the camera lights what faces it, as rough metal reflects a light behind the camera.
    """
    if not solver.is_mostly_metal or is_mostly_metal(reconstruction.gaussians):
        return False
    return not reconstruction.has_split_sum or solver.metal_gain < CLEAR


def _decided(metal: LightMaterialSolver, plain: LightMaterialSolver, glossy: bool, progress: Progress) -> LightMaterialSolver:
    """Return the solver with metal where it explains far more, and the first stage found reflections (`glossy`); else the one without."""
    share = 1 - metal.total_error() / max(plain.total_error(), 1e-30)
    explained = f"metal explains {share:.0%} of the error"
    if not glossy:
        progress.message(f"{explained}, but the first stage found no reflections: none of it is metal")
        return plain
    progress.message(f"{explained}: {'all' if share > DECISIVE else 'none'} of it is metal")
    return metal if share > DECISIVE else plain


def _solve_from_first_stage(
    reconstruction: Reconstruction,
    samples: MultiViewSamples,
    transfer: RadianceTransfer,
    tracer: SecondaryTracer,
    settings: Settings,
    progress: Progress,
    search_metal: bool,
) -> LightMaterialSolver:
    """Run a solver that starts with the roughness and metallic of the nearest Gaussians.

    `search_metal` also allows a dark start, which must end with less error than that with a medium albedo.
    """
    g = reconstruction.gaussians
    roughness, metallic = g.materials()[3:, nearest_neighbours(g.position.T, samples.position, 1)[:, 0]]
    split = partial(split_brightest, samples=samples, tracer=tracer, seed=settings.seed, rows=settings.second.light_height)
    # A light that turns meets other traced rays in each view. Of a metal's light, the first stage's reflections know more.
    stays_coarse = transfer.rotations is not None or is_mostly_metal(g)
    metallic = (metallic > METALLIC_THRESHOLD).float() * search_metal

    def solved(try_dark: bool) -> LightMaterialSolver:
        solver = LightMaterialSolver(samples, transfer, roughness, metallic, settings.seed, search_metal)
        progress.phase("second stage", STEPS)
        run_solver(solver, None if stays_coarse else split, on_step=partial(report_step, progress), try_dark=try_dark)
        return solver

    solver = solved(try_dark=search_metal)
    if solver.start_albedo < MEDIUM and not progress.finish_early:
        # Before its metal is known, an object with metal parts looks darker than it is: what both starts end with decides.
        progress.message("the best fit has a dark albedo: solved again from a medium albedo, to compare")
        medium = solved(try_dark=False)
        solver = min(solver, medium, key=lambda one: one.total_error())
    if solver.start_albedo < MEDIUM:
        progress.message("a dark object under a bright light explains the photographs better")
    if solver.transfer.texels.level.any():
        progress.message("the light is subdivided where it is bright")
    tested, confirmed = solver.regions
    if tested:
        progress.message(f"metal: {confirmed} of {tested} candidate regions confirmed")
    progress.message(f"light and materials explain the photographs: half of their values differ by less than {solver.error():.1%} of white")
    return solver
