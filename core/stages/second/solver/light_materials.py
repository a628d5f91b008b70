# SPDX-License-Identifier: GPL-3.0-or-later
"""Light and materials of points of the surface: samples and traced transfer, the solver's best start, and whether the object is metal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from ....datasets.camera_light import MIN_CAMERA_LIGHT, radiance_slope
from ....errors import IrgsppError
from ....progress.protocol import Progress
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.dataset import Dataset, light_rotations
from ....scene.reconstruction import Reconstruction
from ....scene.surface import Surface
from ....settings.schema import Settings
from ...common.finite_check import require_finite
from ...common.nearest_neighbours import nearest_neighbours
from ..metal import MEAN_METALLIC_THRESHOLD, METALLIC_THRESHOLD, is_mostly_metal
from ..secondary_tracer import secondary_tracer
from ..step_report import report_step
from .albedo_prior import MEDIUM_ALBEDO
from .light_material_solver import LightMaterialSolver, Split
from .light_texels import LightTexels
from .multi_view_samples import MultiViewSamples, sample_views
from .radiance_transfer import RadianceTransfer
from .seen_light import SeenLight, seen_light
from .solver_run import TOTAL_STEPS, run_solver
from .transfer_tracing import split_brightest, trace_radiance_transfer

MIN_POINTS = 50  # with which the light is solved
# Share of the error that metal must explain in the test of its regions where the whole object is to be metal; else the solver runs once
# more without metal. teapot_glossy .69, two metal Suzannes .55 and .33; a resin skull under the camera's flash .18.
MIN_METAL_GAIN = 0.4
# Share of the final error of the solver without metal that the one with metal must explain, for its result to be taken: metal Suzannes .35
# and .28, a gear .21, a lantern of iron .20, a tin with a paper label .14.
MIN_EXPLAINED_SHARE = 0.05
MIN_EXPLAINED_SHARE_BY_FLASH = 0.16  # the same under a light that moves with the camera, where paint looks like rough metal: a skull .12
# Ratio of the errors that both starts end with below which a dark one is taken. A dark pot has .954, black ceramic about .57. A box of
# brown wood has .984, but is not dark: its roughness was .14 off in place of .07.
MAX_DARK_END_RATIO = 0.97
RAYS_PER_SIDE = 2  # rays through each texel of the light along a side


@dataclass(frozen=True, eq=False)
class SolverInputs:
    """What a solver starts from.

    Attributes:
        reconstruction: result of the first stage with aligned normals.
        samples: multi-view samples of P points of the surface.
        transfer: radiance transfer to the points.
        tracer: tracer of the Gaussians.
        settings: settings of the job.
        seen: light that the photographs show directly; None for none.
    """

    reconstruction: Reconstruction
    samples: MultiViewSamples
    transfer: RadianceTransfer
    tracer: SecondaryTracer
    settings: Settings
    seen: SeenLight | None

    def solver(self, search_metal: bool) -> LightMaterialSolver:
        """Return a solver that starts with the roughness and metallic of the nearest Gaussians, without metal unless it is searched."""
        g = self.reconstruction.gaussians
        roughness, metallic = g.materials()[3:, nearest_neighbours(g.position.T, self.samples.position, 1)[:, 0]]
        metallic = (metallic > METALLIC_THRESHOLD).float() * search_metal
        return LightMaterialSolver(self.samples, self.transfer, roughness, metallic, self.settings.seed, search_metal, self.seen)

    def split(self) -> Split | None:
        """Return the function that splits bright texels of the light; None where they stay as they are.

        A light that turns meets other traced rays in each view. Of a metal's light, the first stage's reflections know more.
        """
        if self.transfer.rotations is not None or is_mostly_metal(self.reconstruction.gaussians):
            return None
        seed, rows = self.settings.seed, self.settings.second.light_height
        return partial(split_brightest, samples=self.samples, tracer=self.tracer, seed=seed, rows=rows)


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
    tracer = secondary_tracer(reconstruction, dataset, settings.second)
    samples = _sample_surface(surface, dataset, tracer, settings)
    transfer = _trace_transfer(samples, dataset, tracer, settings, progress)
    require_finite({"the indirect light": transfer.indirect, "a photograph": samples.colour}, "before the second stage")
    inputs = SolverInputs(reconstruction, samples, transfer, tracer, settings, seen_light(dataset, tracer, settings.second))
    # Without masks the surroundings, which are not a distant light, would be taken for reflections on metal, or on a dark object.
    search_metal = dataset.has_alpha or reconstruction.has_split_sum
    solver = _solve_from_first_stage(inputs, search_metal, progress)
    if _is_doubtful_metal(reconstruction, solver):
        progress.message("the solver takes the object for metal, or most of it, but the first stage does not: solved again without metal")
        without_metal = _solve_from_first_stage(inputs, False, progress)
        least = MIN_EXPLAINED_SHARE_BY_FLASH if _is_lit_from_camera(samples) else MIN_EXPLAINED_SHARE
        solver = _decide_metal(solver, without_metal, reconstruction.has_split_sum, least, progress)
    return solver, tracer


def _sample_surface(surface: Surface, dataset: Dataset, tracer: SecondaryTracer, settings: Settings) -> MultiViewSamples:
    """Return multi-view samples of random points of the surface; raise IrgsppError where too few are seen."""
    random = np.random.default_rng(settings.seed)
    position, normal = surface.samples(settings.second.points, random)
    samples, _ = sample_views(position, normal, dataset.train, tracer, random, most=settings.second.views)
    if len(samples.position) < MIN_POINTS:
        raise IrgsppError(
            f"only {len(samples.position)} points of the surface are seen in three photographs, too few to separate materials from light; "
            "check that cameras and masks match, or add photographs that overlap more"
        )
    return samples


def _trace_transfer(
    samples: MultiViewSamples, dataset: Dataset, tracer: SecondaryTracer, settings: Settings, progress: Progress
) -> RadianceTransfer:
    """Return the radiance transfer to the points of samples, from texels of equal size."""
    turns = light_rotations(dataset.train)
    progress.phase("trace", len(samples.position))
    return trace_radiance_transfer(
        samples.position,
        samples.normal,
        tracer,
        LightTexels.uniform(settings.second.rows),
        side=RAYS_PER_SIDE,
        seed=settings.seed,
        indirect=settings.second.indirect,
        on_step=partial(report_step, progress),
        rotations=None if turns is None else torch.from_numpy(turns).to(tracer.device),
    )


def _is_lit_from_camera(samples: MultiViewSamples) -> bool:
    """Return True for samples that are the brighter the more they face the camera."""
    valid = ~samples.saturated.any(1)
    point, radiance, cosine = samples.point[valid], samples.colour[valid].double().mean(1), samples.n_v[valid].double()
    return radiance_slope(*(part.cpu().numpy() for part in (point, radiance, cosine))) > MIN_CAMERA_LIGHT


def _is_doubtful_metal(reconstruction: Reconstruction, solver: LightMaterialSolver) -> bool:
    """Return True for an object that the solver alone takes for metal, without the clear evidence that metal gives.

    A flash on the camera lights what faces it, as rough metal reflects a light behind the camera.
    """
    if float(solver.metallic.mean()) <= MEAN_METALLIC_THRESHOLD or is_mostly_metal(reconstruction.gaussians):
        return False
    return not reconstruction.has_split_sum or solver.metal_gain < MIN_METAL_GAIN


def _decide_metal(
    metal: LightMaterialSolver, without_metal: LightMaterialSolver, reflects: bool, least: float, progress: Progress
) -> LightMaterialSolver:
    """Return the solver with metal where it explains a share above `least`, and the first stage found reflections; else the other one."""
    share = 1 - metal.total_error() / max(without_metal.total_error(), 1e-30)
    explained = f"metal explains {share:.0%} of the error"
    if not reflects:
        progress.message(f"{explained}, but the first stage found no reflections: none of it is metal")
        return without_metal
    progress.message(f"{explained}: {'metal is kept' if share > least else 'none of it is metal'}")
    return metal if share > least else without_metal


def _solve_from_first_stage(inputs: SolverInputs, search_metal: bool, progress: Progress) -> LightMaterialSolver:
    """Run a solver from its better start, and report what it found; `search_metal` also allows a dark start."""
    solver = _solve_from_better_start(partial(_solve, inputs, search_metal, progress), search_metal, progress)
    _report_result(solver, progress)
    return solver


def _solve(inputs: SolverInputs, search_metal: bool, progress: Progress, try_dark: bool) -> LightMaterialSolver:
    """Run a solver; `try_dark` also tries a dark start."""
    solver = inputs.solver(search_metal)
    progress.phase("second stage", TOTAL_STEPS)
    return run_solver(solver, inputs.split(), on_step=partial(report_step, progress), try_dark=try_dark)


def _solve_from_better_start(solve: Callable[[bool], LightMaterialSolver], allow_dark: bool, progress: Progress) -> LightMaterialSolver:
    """Return what `solve(try_dark)` found; a dark start must end with clearly less error than a medium one.

    Before its metal is known, an object with metal parts looks darker than it is: what both starts end with decides.
    """
    solver = solve(allow_dark)
    if solver.start_albedo < MEDIUM_ALBEDO and not progress.finish_early:
        progress.message("the best fit has a dark albedo: solved again from a medium albedo, to compare")
        medium = solve(False)
        return solver if solver.total_error() < MAX_DARK_END_RATIO * medium.total_error() else medium
    return solver


def _report_result(solver: LightMaterialSolver, progress: Progress) -> None:
    """Report in words what a solver found."""
    if solver.start_albedo < MEDIUM_ALBEDO:
        progress.message("a dark object under a bright light explains the photographs better")
    if solver.transfer.texels.level.any():
        progress.message("the light is subdivided where it is bright")
    if solver.started_glossy:
        progress.message("a second start, from a glossy surface, explains the photographs better")
    tested, confirmed = solver.regions
    if tested:
        progress.message(f"metal: {confirmed} of {tested} candidate regions confirmed")
    progress.message(f"light and materials explain the photographs: half of their values differ by less than {solver.error():.1%} of white")
