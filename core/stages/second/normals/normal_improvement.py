# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal improvement: shading turns the surface's normals, reflections turn those of its metal, and the surfels follow them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ....progress.protocol import Progress
from ....rendering.secondary_rays import SecondaryTracer
from ....scene.dataset import Dataset
from ....scene.reconstruction import Reconstruction
from ....scene.surface import Surface
from ....settings.schema import Settings
from ..solver.light_material_solver import LightMaterialSolver
from .diffuse_shading import observe_diffuse_shading
from .normal_alignment import follow_normals
from .normal_fit import fit_rendered_normals
from .reflection_normals import turn_to_reflections
from .shading_normals import ITERATIONS, fit_normals
from .surface_gradient import subdivided


def improve_normals(
    reconstruction: Reconstruction,
    surface: Surface,
    solver: LightMaterialSolver,
    tracer: SecondaryTracer,
    dataset: Dataset,
    settings: Settings,
    progress: Progress,
    on_step: Callable[[int], object],
) -> tuple[Reconstruction, Surface, np.ndarray | None]:
    """Turn the surface's normals so that they explain shading and reflections under the solved light, and the surfels after them.

    Where the light turns relative to the object, only the surfels turn, to the surface's normals.

    Args:
        reconstruction: reconstruction with aligned normals.
        surface: fused from the first stage's depth.
        solver: solved light, and materials of its points.
        tracer: tracer of the Gaussians.
        dataset: training views.
        settings: settings of the job.
        progress: receives the phases "normals" and "turn surfels", and a message on how far normals turned.
        on_step: called with the number of steps done; may raise.

    Returns:
        The reconstruction with turned surfels and its `relief`; the surface, finer where shading turned its normals; and how much of the
        radiance's variation around each of its vertices is relief, (V,) in 0..1, None where shading did not turn them.

    Raises:
        Cancelled: the user stopped the work.
        IrgsppError: a value is not finite.
    """
    second, gaussians, relief = settings.second, reconstruction.gaussians, None
    if second.shading_normals > 0 and solver.transfer.rotations is None:  # the mean over views that it explains is of one light
        progress.phase("normals", ITERATIONS)
        before = subdivided(surface)
        start = subdivided(turn_to_reflections(surface, solver, dataset.train, tracer, settings.seed, on_step))
        shading = observe_diffuse_shading(start, solver, dataset.train, tracer)
        surface, relief = fit_normals(start, shading, on_step)
        if (shading.precision > 0).any():
            reconstruction = replace(reconstruction, relief=float(np.median(relief[shading.precision > 0])))
        turned = np.degrees(np.arccos(np.clip((before.normals * surface.normals).sum(1), -1, 1)))
        progress.message(f"shading and reflections turn the surface's normals by {turned.mean():.1f} degrees on average")
        gaussians = follow_normals(gaussians, before, surface, second.shading_normals)
    if second.normal_iterations > 0:
        progress.phase("turn surfels", second.normal_iterations)
        gaussians = fit_rendered_normals(
            gaussians,
            surface,
            dataset.train,
            radius=reconstruction.bound.radius,
            iterations=second.normal_iterations,
            seed=settings.seed,
            on_step=on_step,
            subpixels=settings.first.subpixels,
        )
    return replace(reconstruction, gaussians=gaussians), surface, relief
