# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials carried from the points they were found at to all Gaussians; albedo is found anew for each, under the known light."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.spatial import KDTree

from ...kernels.reference.harmonics import sh_basis
from ...rendering.secondary_rays import SecondaryTracer
from ...scene.dataset import View
from ...scene.gaussians import METALLIC, Gaussians
from ...scene.reconstruction import Reconstruction
from ...scene.surface import Surface
from ...shading.specular_albedo import diffuse_fraction
from .light_material_solver import OUTLIER, LightMaterialSolver, encoding_slope, view_terms
from .multi_view_samples import MultiViewSamples, observe
from .radiance_transfer import RadianceTransfer, trace_radiance_transfer

NEAREST = 8  # points asked for roughness and metallic
VIEWS = 4  # of each Gaussian
BATCH = 4000  # Gaussians at a time
REWEIGHTED = 8  # passes that take the say from views that don't fit
AROUND = 64  # metal Gaussians that are looked at together
METAL = 0.5  # share of metal among the nearest points from which a Gaussian is metal
EDGE = 2e-3  # materials stay this far inside 0..1: their logits are finite


def assign_materials(
    reconstruction: Reconstruction,
    surface: Surface,
    views: Sequence[View],
    tracer: SecondaryTracer,
    found: LightMaterialSolver,
    seed: int,
    step: Callable[[float], None],
) -> torch.Tensor:
    """(5, N) materials in 0..1 of all Gaussians under the light that was `found`; `step` is told the share done."""
    g, random = reconstruction.gaussians, np.random.default_rng(seed)
    device, position = g.position.device, g.position.T.contiguous().cpu().numpy()
    normal = surface_normals(surface, position)
    seen, chosen = observe(position, normal, views, tracer.tree, tracer.offset, random, VIEWS, least=1, device=device)
    if not reconstruction.glossy:
        seen = with_colour(seen, own_radiance(g, chosen[seen.point], seen.view))
    _, nearest = KDTree(found.seen.position.cpu().numpy()).query(seen.position.cpu().numpy(), k=min(NEAREST, len(found.roughness)))
    around = torch.from_numpy(np.asarray(nearest).reshape(len(seen.position), -1)).to(device)
    roughness, metallic = found.roughness[around].mean(1), (found.metallic[around].mean(1) > METAL).float()
    albedo = torch.empty_like(seen.position)
    for begin in range(0, len(albedo), BATCH):
        part = slice(begin, begin + BATCH)
        batch = seen.part(begin, min(begin + BATCH, len(albedo)))
        transfer = trace_radiance_transfer(batch.position, batch.normal, tracer, found.transfer.height, 1, seed, found.transfer.bounces)
        albedo[part] = fitted_albedo(batch, transfer, found.light, roughness[part], metallic[part])
        step(min(1.0, (begin + BATCH) / len(albedo)))
    metal = metallic > 0
    albedo[metal] = medians(seen.position[metal], albedo[metal])
    materials = torch.cat([albedo, roughness[:, None], metallic[:, None]], 1).clamp(EDGE, 1 - EDGE)
    _, source = KDTree(seen.position.cpu().numpy()).query(position)  # a Gaussian that no view sees is like its neighbour
    return materials[torch.from_numpy(np.asarray(source)).to(device)].T.contiguous()


def surface_normals(surface: Surface, position: np.ndarray) -> np.ndarray:
    """(N, 3) float32 unit normals of the surface at the vertices nearest to (N, 3) points, a mean of a few."""
    _, nearest = KDTree(surface.vertices).query(position, k=min(4, len(surface.vertices)))
    normal = surface.normals[np.asarray(nearest).reshape(len(position), -1)].mean(1)
    return (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)).astype(np.float32)


def own_radiance(gaussians: Gaussians, index: torch.Tensor, view: torch.Tensor) -> torch.Tensor:
    """(K, 3) linear SH radiance of Gaussians (K,) towards (K, 3): sharper than a photograph's pixels, as the images were fitted by it."""
    basis = sh_basis(-view.T, 3)
    return ((basis[:, None] * gaussians.sh[:, :, index]).sum(0) + 0.5).clamp_min(0).T.contiguous()


def with_colour(seen: MultiViewSamples, colour: torch.Tensor) -> MultiViewSamples:
    """The same views with other colours (K, 3)."""
    return MultiViewSamples(seen.position, seen.normal, seen.point, seen.view, colour, seen.saturated)


def fitted_albedo(
    seen: MultiViewSamples, transfer: RadianceTransfer, light: torch.Tensor, roughness: torch.Tensor, metallic: torch.Tensor
) -> torch.Tensor:
    """(P, 3) albedo that explains the views best under a light (T, 3), by reweighted least squares."""
    scaled, added, rest_scaled, rest_added = transfer.rows(seen, roughness)
    point, metal = seen.point, metallic[seen.point][:, None]
    irradiance = (transfer.irradiance @ light + transfer.indirect)[point]
    n_v = (seen.normal[point] * seen.view).sum(1).clamp_min(1e-3)
    share = diffuse_fraction(n_v, roughness[point])[:, None]
    factor, rest = view_terms(metal, share, irradiance, scaled @ light + rest_scaled, added @ light + rest_added)
    slope = encoding_slope(seen.colour)
    # First all views of a point count alike in linear light: by its slope one that is dark by mistake would have all the say.
    trust = slope**-2
    for _ in range(REWEIGHTED):
        weight = trust * slope**2
        albedo = seen.sums(weight * factor * (seen.colour - rest)) / seen.sums(weight * factor * factor).clamp_min(1e-9)
        error = (albedo[point] * factor + rest - seen.colour) * slope
        trust = torch.where(seen.saturated & (error > 0), 0.0, 1 / (1 + (error / OUTLIER) ** 2))
    return albedo


def either_metal_or_not(gaussians: Gaussians) -> torch.Tensor:
    """(5, N) logits of materials: each disk all metal or none of it, as most of those around it are.

    What lies between explains errors of normals, not a material.
    """
    materials, position = gaussians.materials().detach(), gaussians.position.detach().T
    metallic = medians(position, materials[METALLIC, :, None])[:, 0] > METAL
    materials = torch.cat([materials[:METALLIC], metallic[None].float().clamp(EDGE, 1 - EDGE)])
    return torch.logit(materials)


def medians(position: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """(P, C) medians of values (P, C), such as albedo, over AROUND neighbours.

    A metal's is what it reflects divided by what it should: a small error of the normal finds another part of the light, and a single
    surfel's albedo is worth little.
    """
    if not len(position):
        return values
    places = position.cpu().numpy()
    _, nearest = KDTree(places).query(places, k=min(AROUND, len(places)))
    around = torch.from_numpy(np.asarray(nearest).reshape(len(places), -1)).to(position.device)
    return values[around].median(1).values
