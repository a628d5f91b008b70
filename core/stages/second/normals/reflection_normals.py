# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of a mesh's metal by its reflections: rounds of a search at each vertex under the solved light, and an average over neighbours.

A search at a single vertex is noisy. Several rounds also reach normals that are wrong by more than one search can turn them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from ....rendering.secondary_rays import SecondaryTracer
from ....scene.dataset import View
from ....scene.surface import Surface
from ....surface.meshing import unit
from ....surface.topology import neighbour_average
from ..metal import METALLIC_THRESHOLD
from ..solver.light_material_solver import LightMaterialSolver
from ..solver.metal_normals import search_normals
from ..solver.multi_view_samples import MultiViewSamples, sample_views
from ..solver.radiance_transfer import RadianceTransfer
from ..solver.transfer_tracing import trace_radiance_transfer
from .diffuse_shading import nearest_points

SEARCH_ROUNDS = 3  # of searches, each around the last one's normals
AVERAGING_PASSES = 2  # of the turn with the neighbours', after each search
MAX_VIEWS = 8  # of a vertex, at most
BATCH = 2000  # vertices searched at a time; those of one batch share their roughness
MAX_KEPT_VERTICES = 10_000  # vertices up to which the transfer to them is kept from round to round, about 130 MB; else it is traced anew


def turn_to_reflections(
    surface: Surface,
    solver: LightMaterialSolver,
    views: Sequence[View],
    tracer: SecondaryTracer,
    seed: int,
    on_step: Callable[[int], object] = lambda done: None,
) -> Surface:
    """Turn the normals of metal so that they reflect what the photographs show; vertices stay.

    Args:
        surface: mesh with V vertices.
        solver: solved light, which stands still, and materials of its points.
        views: training images.
        tracer: tracer of the Gaussians.
        seed: seed of the random choice of views and of ray directions.
        on_step: called with 0 now and then; may raise.

    Returns:
        The mesh with new normals; the same one without metal.
    """
    metal, roughness = _metal_vertices(surface, solver)
    if not len(metal):
        return surface
    position, normal = surface.vertices[metal].astype(np.float32), surface.normals[metal].astype(np.float32)
    random = np.random.default_rng(seed)
    samples, seen = sample_views(position, normal, views, tracer, random, most=MAX_VIEWS)
    chosen = seen.cpu().numpy()
    metal, roughness = metal[chosen], roughness[chosen]
    average, normals = neighbour_average(surface.faces, len(surface.vertices)), surface.normals
    batches = partial(_batches, samples, solver, tracer, seed)
    kept = list(batches()) if len(metal) <= MAX_KEPT_VERTICES else None
    for _ in range(SEARCH_ROUNDS):
        change = np.zeros_like(normals)
        for part, own, transfer in kept or batches():
            on_step(0)
            change[metal[part]] = _turn(normals[metal[part]], own, transfer, solver.light, float(np.median(roughness[part])))
        for _ in range(AVERAGING_PASSES):
            change = average @ change
        normals = unit(normals + change)
    return replace(surface, normals=normals)


def _turn(normals: np.ndarray, samples: MultiViewSamples, transfer: RadianceTransfer, light: torch.Tensor, roughness: float) -> np.ndarray:
    """Return by how much normals (P, 3) of metal turn, (P, 3), in one search."""
    around = torch.from_numpy(normals).to(light)
    _, found = search_normals(samples, transfer, light, around, light.new_tensor([roughness]))
    return (found[:, 0] - around).double().cpu().numpy()


def _metal_vertices(surface: Surface, solver: LightMaterialSolver) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices of metal in the order of their roughness, and that roughness."""
    index, weight = nearest_points(surface, solver)
    roughness, metallic = ((values.cpu().numpy()[index] * weight).sum(1) for values in (solver.roughness, solver.metallic))
    metal = np.flatnonzero(metallic > METALLIC_THRESHOLD)
    metal = metal[np.argsort(roughness[metal], kind="stable")]
    return metal, roughness[metal]


def _batches(
    samples: MultiViewSamples, solver: LightMaterialSolver, tracer: SecondaryTracer, seed: int
) -> Iterator[tuple[slice, MultiViewSamples, RadianceTransfer]]:
    """Yield batches of points, their samples, and the transfer to them."""
    for begin in range(0, len(samples.position), BATCH):
        part = slice(begin, min(begin + BATCH, len(samples.position)))
        own = samples.part(part.start, part.stop)
        indirect = solver.transfer.has_indirect
        yield part, own, trace_radiance_transfer(own.position, own.normal, tracer, solver.transfer.texels, seed=seed, indirect=indirect)
