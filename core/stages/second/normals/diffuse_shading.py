# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffuse shading of a mesh's vertices: radiance of the photographs without gloss, and irradiance with shadows and indirect light."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from scipy.spatial import KDTree

from ....rendering.secondary_rays import SecondaryTracer
from ....scene.dataset import View
from ....scene.spherical_harmonics import sh_basis
from ....scene.surface import Surface
from ....shading.specular_albedo import diffuse_fraction
from ....shading.split_sum import specular_light, specular_radiance
from ..metal import METALLIC_THRESHOLD
from ..solver.light_material_solver import LightMaterialSolver
from ..solver.multi_view_samples import MultiViewSamples, sample_views
from .shading_normals import MIN_IRRADIANCE, DiffuseShading

MAX_VIEWS = 32  # sampled, at most, spread over all
FRONTAL_POWER = 4  # power of the cosine between normal and view by which a sample counts; oblique views blur what lies off the mesh
CAUCHY_SCALE = 0.05  # difference of log radiance from the mean at which a sample's weight is halved (Cauchy)
REWEIGHTING_PASSES = 5  # passes of iteratively reweighted least squares
MIN_DEVIATION = 0.03  # standard deviation of log radiance where all views agree
CERTAIN_WEIGHT = 2.0  # weight of the views from which on they count as certain
NEAREST_POINTS = 4  # solver points that a vertex takes light and materials from
OPPOSITE_NORMAL_DISTANCE = 0.3  # distance, in multiples of the mesh's size, as which opposite normals count in the choice of these
# Convolution with the cosine lobe over pi, per coefficient (Ramamoorthi, Hanrahan 2001).
LAMBERT_CONVOLUTION = (1.0,) + (2 / 3,) * 3 + (1 / 4,) * 5
BATCH = 200_000  # samples shaded at a time


def observe_diffuse_shading(
    surface: Surface, solver: LightMaterialSolver, views: Sequence[View], tracer: SecondaryTracer
) -> DiffuseShading:
    """Observe the vertices of a mesh in the photographs.

    Args:
        surface: mesh with V vertices.
        solver: solved light, and materials of its points.
        views: training images.
        tracer: tracer of the Gaussians; decides which view sees a vertex.
    """
    vertices, normals = surface.vertices.astype(np.float32), surface.normals.astype(np.float32)
    chosen = [views[k] for k in np.unique(np.linspace(0, len(views) - 1, min(MAX_VIEWS, len(views))).round().astype(int))]
    random = np.random.default_rng(0)
    samples, seen = sample_views(vertices, normals, chosen, tracer, random, most=MAX_VIEWS, least=1)
    harmonics, fraction = point_irradiance(solver)
    materials = torch.stack([solver.roughness, solver.metallic, fraction], 1)
    index, weight = nearest_points(surface, solver)
    around = (materials.cpu().numpy()[index] * weight[..., None]).sum(1)
    irradiance = np.asarray(sum(harmonics[index[:, k]] * weight[:, k, None, None] for k in range(index.shape[1])))
    at = torch.from_numpy(around.astype(np.float32)).to(tracer.device)[seen]
    log_radiance, precision = mean_diffuse_radiance(samples, solver, at)
    values, certain = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    values[seen.cpu().numpy()], certain[seen.cpu().numpy()] = log_radiance, precision
    return DiffuseShading(values, np.where(around[:, 1] > METALLIC_THRESHOLD, 0, certain), irradiance)


def point_irradiance(solver: LightMaterialSolver) -> tuple[np.ndarray, torch.Tensor]:
    """Expand the irradiance at the solver's P points in spherical harmonics of the normal.

    Returns:
        (P, 9, 3) coefficients of irradiance / pi, exact at the points' own normals, and the fraction (P,) of the light's irradiance
        that shadows leave and indirect light adds, 0..1.
    """
    transfer, light, normal = solver.transfer, solver.light, solver.samples.normal
    direction, solid_angle, visibility, indirect = (torch.as_tensor(array) for array in transfer.traced)
    basis = sh_basis(direction, 2) * solid_angle * direction.new_tensor(LAMBERT_CONVOLUTION)[:, None]
    distant = light.repeat(direction.shape[1] // len(light), 1)
    harmonics = torch.stack([(visibility * distant[:, c] + indirect[:, c]) @ basis.T for c in range(3)], 2)
    exact = transfer.irradiance @ light + transfer.indirect
    approximate = torch.einsum("kp,pkc->pc", sh_basis(normal.T, 2), harmonics)
    unoccluded = ((normal @ direction).clamp_min(0) * solid_angle / math.pi) @ distant
    scale = (exact / approximate.clamp_min(MIN_IRRADIANCE)).clamp(0.5, 2)
    irradiance_fraction = (exact.sum(1) / unoccluded.sum(1).clamp_min(1e-9)).clamp(0, 1)
    return (harmonics * scale[:, None]).double().cpu().numpy(), irradiance_fraction


def mean_diffuse_radiance(samples: MultiViewSamples, solver: LightMaterialSolver, materials: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Average the views' radiance less the gloss of a dielectric, over what the coat leaves of the diffuse light.

    Args:
        samples: K samples of P points.
        solver: its light is reflected.
        materials: (P, 3) roughness, metallic and `irradiance_fraction` of the points.

    Returns:
        (P, 3) log of the robust mean, and its precision (P,), 1 / variance.
    """
    weight = (samples.n_v**FRONTAL_POWER)[:, None]
    value = torch.cat([part.log() for part in _diffuse_parts(samples, solver, materials)])
    mean, robust = samples.sums(weight * value) / samples.sums(weight), weight
    for _ in range(REWEIGHTING_PASSES):
        robust = weight / (1 + ((value - mean[samples.point]) / CAUCHY_SCALE) ** 2)
        mean = samples.sums(robust * value) / samples.sums(robust)
    variance = (samples.sums(robust * (value - mean[samples.point]) ** 2) / samples.sums(robust)).mean(1)
    precision = (samples.sums(weight)[:, 0] / CERTAIN_WEIGHT).clamp(0, 1) / (variance + MIN_DEVIATION**2)
    return mean.double().cpu().numpy(), precision.double().cpu().numpy()


def _diffuse_parts(samples: MultiViewSamples, solver: LightMaterialSolver, materials: torch.Tensor) -> Iterator[torch.Tensor]:
    """Yield the diffuse radiance (B, 3) of the samples, batch by batch."""
    stack = specular_light(solver.light_map(solver.transfer.texels.finest_height))
    for begin in range(0, len(samples.point), BATCH):
        part = slice(begin, begin + BATCH)
        point, view = samples.point[part], samples.view[part]
        roughness, irradiance_fraction = materials[point, 0].contiguous(), materials[point, 2:]
        dark = torch.zeros_like(view)  # a dielectric's gloss does not depend on its albedo
        gloss = specular_radiance(view, samples.normal[point].contiguous(), dark, roughness, dark[:, 0].contiguous(), stack)
        diffuse = (samples.colour[part] - gloss * irradiance_fraction) / diffuse_fraction(samples.n_v[part], roughness)[:, None]
        yield diffuse.clamp_min(2 * MIN_IRRADIANCE)


def nearest_points(surface: Surface, solver: LightMaterialSolver) -> tuple[np.ndarray, np.ndarray]:
    """Find the solver's points that are nearest to each of V vertices in place and normal.

    Returns:
        Indices (V, N), and weights (V, N) of sum 1.
    """
    size = OPPOSITE_NORMAL_DISTANCE * float(np.linalg.norm(np.ptp(surface.vertices, axis=0))) / 2
    places = np.concatenate([solver.samples.position.cpu().numpy(), size * solver.samples.normal.cpu().numpy()], 1)
    count = min(NEAREST_POINTS, len(places))
    distance, index = KDTree(places).query(np.concatenate([surface.vertices, size * surface.normals], 1), k=count, workers=-1)
    weight = 1 / (distance.reshape(-1, count) + 1e-3 * size)
    return index.reshape(-1, count), weight / weight.sum(1, keepdims=True)
