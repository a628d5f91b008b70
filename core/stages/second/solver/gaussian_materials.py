# SPDX-License-Identifier: GPL-3.0-or-later
"""Assignment of materials to Gaussians: roughness from the solver's points, metallic and albedo fitted under the solved light.

The albedo of a dielectric has a prior, as during the solution (`likely_albedo`); that of a metal is a median over its neighbourhood.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.spatial import KDTree

from ....rendering.secondary_rays import SecondaryTracer
from ....scene.dataset import View
from ....scene.reconstruction import Reconstruction
from ....scene.surface import Surface
from ....shading.specular_albedo import diffuse_fraction
from ...common.nearest_neighbours import nearest_neighbours
from .albedo_prior import likely_albedo
from .light_material_solver import LightMaterialSolver
from .metal_borders import AlbedoFit, NearbyPoints, drawn_metal, nearby_points
from .multi_view_samples import MultiViewSamples
from .radiance_transfer import RadianceTransfer
from .sample_equation import CAUCHY_SCALE, approximate_srgb_derivative, least_squares_albedo, robust_error, view_terms
from .sharp_samples import sharp_samples
from .transfer_tracing import trace_radiance_transfer

BATCH = 4000  # Gaussians traced at a time
REWEIGHTING_PASSES = 7  # passes of iteratively reweighted least squares after a first one with equal weights
MEDIAN_NEIGHBOURS = 64  # nearest Gaussians whose median replaces a metal's albedo
LOGIT_MARGIN = 2e-3  # materials are kept this far inside 0..1, so that their logits are finite


def assign_materials(
    reconstruction: Reconstruction,
    surface: Surface,
    views: Sequence[View],
    tracer: SecondaryTracer,
    solver: LightMaterialSolver,
    seed: int,
    on_fraction: Callable[[float], object],
    subpixels: int = 1,
    relief: np.ndarray | None = None,
) -> torch.Tensor:
    """Assign materials to all Gaussians under the solved light.

    A Gaussian that no view sees takes the materials of the nearest one that is seen.

    Args:
        reconstruction: N Gaussians.
        surface: supplies normals.
        views: training images.
        tracer: tracer of the Gaussians.
        solver: solved light, and materials of its points.
        seed: seed of the random choice of views and of ray directions.
        on_fraction: called with the fraction done, 0..1.
        subpixels: rays along each side of a pixel with which the radiance was fitted.
        relief: (V,) 0..1, how much of the radiance's variation around the surface's vertices is relief (`relief_fraction`); None: unknown.

    Returns:
        (5, N) albedo (3), roughness, metallic in 0..1.
    """
    g = reconstruction.gaussians
    position = g.position.T.contiguous().cpu().numpy()
    paint = None if relief is None else 1 - relief[KDTree(surface.vertices).query(position)[1]]
    samples = sharp_samples(reconstruction, surface_normals(surface, position), views, tracer, seed, subpixels, paint)
    nearby = nearby_points(solver.samples.position, solver.roughness, solver.metallic, samples.position)
    dielectric, conductor = _fits(samples, nearby, tracer, solver, seed, on_fraction)
    metal = drawn_metal(samples.position, samples.sums(samples.colour) / samples.lengths[:, None], nearby, dielectric, conductor)
    albedo, known_metal = torch.where(metal[:, None], conductor.albedo, dielectric.albedo), solver.metallic > 0
    if not bool(metal.all() | known_metal.all()):
        found = AlbedoFit(*(values[~metal] for values in dielectric))
        albedo[~metal] = likely_albedo(*found, solver.albedo[~known_metal], seed)
    albedo[metal] = neighbourhood_medians(samples.position[metal], albedo[metal])
    roughness = torch.where(metal, nearby.roughness[1], nearby.roughness[0])
    materials = torch.cat([albedo, roughness[:, None], metal[:, None].float()], 1).clamp(LOGIT_MARGIN, 1 - LOGIT_MARGIN)
    return materials[nearest_neighbours(samples.position, g.position.T, 1)[:, 0]].T.contiguous()


def _fits(
    samples: MultiViewSamples,
    nearby: NearbyPoints,
    tracer: SecondaryTracer,
    solver: LightMaterialSolver,
    seed: int,
    on_fraction: Callable[[float], object],
) -> tuple[AlbedoFit, AlbedoFit]:
    """Fit the albedo of surfels as dielectrics, unless all are metal, and as metal where that is nearby; zeros elsewhere."""
    count, known, colour = len(samples.position), solver.transfer, samples.colour
    tried = (torch.full_like(nearby.share, not bool((nearby.share >= 1).all()), dtype=torch.bool), nearby.share > 0)
    fits = [AlbedoFit(colour.new_zeros(count, 3), colour.new_zeros(count, 3), colour.new_zeros(count)) for _ in tried]
    for begin in range(0, count, BATCH):
        part = slice(begin, begin + BATCH)
        batch = samples.part(begin, min(begin + BATCH, count))
        transfer = trace_radiance_transfer(
            batch.position,
            batch.normal,
            tracer,
            known.texels,
            seed=seed,
            indirect=known.has_indirect,
            rotations=known.rotations,
        )
        for metallic, (fit, kept) in enumerate(zip(fits, tried, strict=True)):
            rows = begin + torch.nonzero(kept[part])[:, 0]
            if not len(rows):
                continue
            chosen = (batch, transfer) if len(rows) == len(batch.position) else (batch.subset(kept[part]), transfer.subset(kept[part]))
            found = fitted_albedo(*chosen, solver.light, nearby.roughness[metallic, rows], torch.full_like(fit.error[rows], metallic))
            for values, new in zip(fit, found, strict=True):
                values[rows] = new
        on_fraction(min(1.0, (begin + BATCH) / count))
    return fits[0], fits[1]


def surface_normals(surface: Surface, position: np.ndarray) -> np.ndarray:
    """Average the surface's normals at the vertices nearest to each point.

    On thin parts both sides are near. The side whose tangent planes are nearest counts alone: opposite normals would cancel.

    Args:
        surface: mesh with vertex normals.
        position: (N, 3) points, world.

    Returns:
        (N, 3) float32 unit normals.
    """
    _, nearest = KDTree(surface.vertices).query(position, k=min(4, len(surface.vertices)))
    around = np.asarray(nearest).reshape(len(position), -1)
    normals = surface.normals[around]
    height = np.abs(((position[:, None] - surface.vertices[around]) * normals).sum(-1))
    side = np.take_along_axis(normals, height.argmin(1)[:, None, None], 1)
    normal = (normals * ((normals * side).sum(-1, keepdims=True) > 0)).sum(1)
    return (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)).astype(np.float32)


def fitted_albedo(
    samples: MultiViewSamples, transfer: RadianceTransfer, light: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor
) -> AlbedoFit:
    """Fit the albedo to the samples under a known light, by iteratively reweighted least squares with Cauchy weights.

    Args:
        samples: K samples of P points.
        transfer: radiance transfer to the points.
        light: (T, 3) linear radiance.
        roughness: (P,).
        metallic: (P,).
    """
    f0_term, fresnel_term, f0_indirect, fresnel_indirect = transfer.rows(samples, roughness)
    point, metal = samples.point, metallic[samples.point][:, None]
    irradiance = transfer.diffuse_rows(samples).irradiance(light)
    diffuse = diffuse_fraction(samples.n_v, roughness[point])[:, None]
    factor, rest = view_terms(metal, diffuse, irradiance, f0_term @ light + f0_indirect, fresnel_term @ light + fresnel_indirect)
    derivative = approximate_srgb_derivative(samples.colour)
    # At first all samples of a point weigh the same in linear radiance: by the derivative a wrongly dark one would dominate.
    albedo = least_squares_albedo(samples, torch.ones_like(factor), factor, rest)
    for _ in range(REWEIGHTING_PASSES):
        error = (albedo[point] * factor + rest - samples.colour) * derivative
        weight = torch.where(samples.saturated & (error > 0), 0.0, derivative**2 / (1 + (error / CAUCHY_SCALE) ** 2))
        fit = least_squares_albedo(samples, weight, factor, rest)
        # Where all samples of a point are clipped and the model is brighter, no sample tells more: the albedo stays as it is.
        albedo = torch.where(samples.sums(weight) > 0, fit, albedo)
    error = robust_error(samples, albedo[point] * factor + rest, derivative) / samples.lengths
    return AlbedoFit(albedo, samples.sums(weight * factor * factor), error)


def neighbourhood_medians(position: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Compute medians of values over the MEDIAN_NEIGHBOURS nearest points.

    The albedo of a metal is its observed over its expected reflection. A small error of the normal reflects another part of the light,
    so that the albedo of a single surfel is unreliable.

    Args:
        position: (P, 3).
        values: (P, C).

    Returns:
        (P, C) medians.
    """
    if not len(position):
        return values
    return values[nearest_neighbours(position, position, MEDIAN_NEIGHBOURS)].median(1).values
