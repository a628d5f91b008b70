# SPDX-License-Identifier: GPL-3.0-or-later
"""Second stage: environment light and materials by the rendering equation, with visibility and indirect light traced through Gaussians.

The closed steps, in order: surfels are added where no view sees the surface (`unseen_surface`), all are aligned with it (`normals/`),
light and materials are solved for points of it (`solver/`), normals follow the shading (`normals/`), materials go to the Gaussians
(`solver/`), are refined on single pixels (`refinement/`), and the radiance is fitted again. `joint/` holds the joint optimisation, which
replaces or refines them.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from ...io.run_files import FINE_SURFACE
from ...progress.protocol import Checkpoint, Progress
from ...rendering.gbuffer_cache import GBufferCache
from ...rendering.secondary_rays import SecondaryTracer
from ...scene.dataset import Dataset
from ...scene.reconstruction import Reconstruction
from ...scene.surface import Surface
from ...scene.surface_ply import save_surface_ply
from ...settings.schema import Settings
from ...surface.extraction import coarser
from ..common.finite_check import require_finite
from ..common.time_budget import scaled_iterations
from .held_back import without_held_back
from .joint.solve import optimise_jointly, refine_jointly
from .metal import is_mostly_metal
from .normals.normal_alignment import align_normals
from .normals.normal_improvement import improve_normals
from .radiance_refit import refit_radiance
from .refinement.refinement_selection import refine
from .secondary_tracer import secondary_tracer
from .solver.gaussian_materials import assign_materials
from .solver.light_material_solver import LightMaterialSolver
from .solver.light_materials import solve_light_materials
from .solver.metal_starts import metal_starts
from .step_report import report_step
from .unseen_surface import with_unseen_surface

CLOSED_FRACTION = 0.5  # of the time that is left, for the closed solver where the joint optimisation refines its result
MAX_SOLVED_TRIANGLES = 40_000  # of the surface whose points light and materials are solved for


class SecondStageResult(NamedTuple):
    """Result of the second stage.

    Attributes:
        reconstruction: with materials and light.
        schedule_scale: schedules as a multiple of the settings'.
        surface: surface with the normals that explain the photographs' shading, of four times the given triangles; the given one where
            the light turns; None for an object of metal, or where surfels have moved.
    """

    reconstruction: Reconstruction
    schedule_scale: float
    surface: Surface | None = None

    def save(self, run: Path) -> None:
        """Write the reconstruction and the surface into a run folder."""
        save_surface_ply(self.surface, run / FINE_SURFACE)
        self.reconstruction.save(run)


def solve_second_stage(
    reconstruction: Reconstruction,
    surface: Surface,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    deadline: float | None = None,
    checkpoint: Checkpoint | None = None,
) -> SecondStageResult:
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

    Raises:
        Cancelled: the user stopped the work.
        InputError: the photographs do not fit the solver.
        IrgsppError: too few points of the surface are seen, or a value is not finite.
    """
    solver = settings.second.solver
    if solver == "joint":
        return SecondStageResult(*optimise_jointly(reconstruction, dataset, settings, progress, deadline, checkpoint))
    if solver == "closed":
        return solve_in_closed_form(reconstruction, surface, dataset, settings, progress, deadline)
    now = time.monotonic()
    middle = None if deadline is None else now + CLOSED_FRACTION * (deadline - now)
    closed = solve_in_closed_form(reconstruction, surface, dataset, settings, progress, middle)
    refined, schedule_scale = refine_jointly(closed.reconstruction, dataset, settings, progress, deadline, checkpoint)
    return SecondStageResult(refined, schedule_scale, closed.surface if refined is closed.reconstruction else None)


def solve_in_closed_form(
    reconstruction: Reconstruction,
    surface: Surface,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    deadline: float | None = None,
) -> SecondStageResult:
    """Solve for materials and environment light, align the surfels' normals, and fit the radiance again to them.

    Positions, scales and opacities do not change; surfels are added where no view sees the surface. Views that judge a refinement are
    left out of all that comes before it (`held_back`). See `solve_second_stage`.

    Args:
        reconstruction: result of the first stage.
        surface: fused from its depth.
        dataset: training views.
        settings: settings of the job.
        progress: receives the progress and may cancel.
        deadline: see `solve_second_stage`.
    """
    reconstruction = _with_unseen_surface(reconstruction, surface, dataset, settings.seed, progress)
    reconstruction = _with_aligned_normals(reconstruction, surface, settings)
    refined_later = settings.second.iterations > 0 or settings.second.solver == "closed+joint"
    seen = without_held_back(dataset) if refined_later else dataset
    # The noise of a finer mesh's normals hides metal: on capture_ogre, albedo loses 1 dB with 70,000 triangles.
    solver, tracer = solve_light_materials(reconstruction, coarser(surface, MAX_SOLVED_TRIANGLES), seen, settings, progress)
    metal, relief = _is_metal(reconstruction, solver), None
    if not metal:
        on_step = partial(report_step, progress)
        reconstruction, surface, relief = improve_normals(reconstruction, surface, solver, tracer, seen, settings, progress, on_step)
        tracer = secondary_tracer(reconstruction, dataset, settings.second)  # turned surfels cover other pixels
    starts = [_with_solved_materials(reconstruction, surface, relief, solver, tracer, seen, settings, progress)]
    if reconstruction.has_split_sum and solver.is_all_metal:
        starts = metal_starts(reconstruction, starts[0], solver)
    result, schedule_scale = refine(starts, dataset, tracer, settings, progress, deadline, None if metal else surface)
    iterations = scaled_iterations(schedule_scale, settings.second.radiance_iterations)
    result = _with_refitted_radiance(result, dataset, iterations, settings, progress)
    return SecondStageResult(result, schedule_scale, None if metal else surface)


def _with_unseen_surface(
    reconstruction: Reconstruction, surface: Surface, dataset: Dataset, seed: int, progress: Progress
) -> Reconstruction:
    """Add surfels where the closed surface has none; without masks, it ends where the photographs do."""
    if not dataset.has_alpha:
        return reconstruction
    views = GBufferCache(reconstruction, [view.camera for view in dataset.train])
    filled = with_unseen_surface(reconstruction, surface, views, seed)
    added = filled.gaussians.count - reconstruction.gaussians.count
    if added:
        progress.message(f"{added:,} surfels added where no photograph shows the surface")
    return filled


def _with_aligned_normals(reconstruction: Reconstruction, surface: Surface, settings: Settings) -> Reconstruction:
    """Align the surfels with the surface, except a metal's: reflections in the first stage know its normals better than smooth depth."""
    fraction = settings.second.mesh_normals
    if fraction == 0 or is_mostly_metal(reconstruction.gaussians):
        return reconstruction
    return replace(reconstruction, gaussians=align_normals(reconstruction.gaussians, surface, fraction))


def _is_metal(reconstruction: Reconstruction, solver: LightMaterialSolver) -> bool:
    """Return True where the first stage takes the object for metal, or the solver all of it, so that nothing has diffuse shading."""
    return is_mostly_metal(reconstruction.gaussians) or solver.is_all_metal


def _with_solved_materials(
    reconstruction: Reconstruction,
    surface: Surface,
    relief: np.ndarray | None,
    solver: LightMaterialSolver,
    tracer: SecondaryTracer,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
) -> Reconstruction:
    """Return a reconstruction with the solved light, and materials of all surfels under it."""
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
        relief=relief,
    )
    enlarged = solver.light_map(settings.second.light_height)
    require_finite({"a material": materials, "the light": enlarged}, "at the end of the second stage")
    return reconstruction.relabelled(torch.logit(materials), enlarged)


def _with_refitted_radiance(
    reconstruction: Reconstruction, dataset: Dataset, iterations: int, settings: Settings, progress: Progress
) -> Reconstruction:
    """Fit the radiance again to the turned surfels; return the same reconstruction with 0 iterations."""
    if not iterations:
        return reconstruction
    progress.phase("radiance", iterations)
    return refit_radiance(
        reconstruction,
        dataset.train,
        iterations,
        seed=settings.seed,
        on_step=partial(report_step, progress),
        subpixels=settings.first.subpixels,
    )
