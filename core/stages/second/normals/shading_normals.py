# SPDX-License-Identifier: GPL-3.0-or-later
"""Shading normals: under the solved light, relief of the surface that explains the shading of the photographs.

The unknowns are a displacement of each vertex along its normal and its log albedo; the normals follow from the gradient of the
displacement, so that they belong to a surface (shape from shading, with a known light). Albedo and shading are told apart by colour:
shading under a nearly white light does not change the chromaticity, paint mostly does, so that the albedo's luminance may vary between
neighbours about as much as the chromaticity does around them. Grey paint does not differ in colour: there, normals turn as far as the
coarser relief of the mesh explains its shading (`relief_evidence`). A painted surface therefore keeps its normals, a carved one moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from ....machine.thread_pool import run_jobs
from ....scene.spherical_harmonics import sh_basis
from ....scene.surface import Surface
from .relief_evidence import relief_fraction
from .surface_gradient import SurfaceGradient

ITERATIONS = 4  # Gauss-Newton steps with new robust weights
RELIEF_ITERATIONS = 3  # further steps where the relief turns out to be strong
CG_ITERATIONS = 40  # conjugate gradient iterations in each
CG_TOLERANCE = 1e-3  # of the conjugate gradients' residual
CAUCHY_SCALE = 2.0  # residual over its standard deviation at which a vertex's robust weight is halved (Cauchy)
# Standard deviations of the displacement, its gradient and its Laplacian, in edges.
DISPLACEMENT_DEVIATION, SLOPE_DEVIATION, LAPLACIAN_DEVIATION = 1.5, 0.25, 0.4
# Standard deviation of the gradient over the root mean square of what was found with SLOPE_DEVIATION, which the prior shrinks.
SLOPE_DEVIATION_RATIO = 7.0
MAX_SLOPE_DEVIATION = 0.6  # standard deviation of the gradient, at most
MIN_RELIEF = 0.02  # least fraction of these deviations, where nothing tells of relief
ALBEDO_DEVIATION = 0.005  # standard deviation of log albedo along an edge where the chromaticity does not vary
PAINT_LUMINANCE_RATIO = 10.0  # by which the luminance of paint varies more than its chromaticity
CHROMATICITY_NOISE = 0.004  # of log chromaticity, along an edge
SPREAD_PASSES = 16  # passes that spread the variation of chromaticity over neighbours
SPREAD_FRACTION = 0.7  # fraction of the way to the mean of its neighbours that a vertex goes in each pass
MIN_IRRADIANCE = 1e-3  # least irradiance / pi


@dataclass(frozen=True, eq=False)
class DiffuseShading:
    """Observed diffuse radiance of V vertices, and the light that reaches them.

    Attributes:
        log_radiance: (V, 3) log of the mean diffuse radiance.
        precision: (V,) 1 / variance of it, 0 where it is unknown.
        irradiance: (V, 9, 3) spherical harmonics of irradiance / pi as a function of the normal.
    """

    log_radiance: np.ndarray
    precision: np.ndarray
    irradiance: np.ndarray


def fit_normals(
    surface: Surface, shading: DiffuseShading, on_step: Callable[[int], object] = lambda done: None
) -> tuple[Surface, np.ndarray]:
    """Turn the normals of a surface so that they explain its shading; vertices stay.

    Args:
        surface: mesh with V vertices and smooth normals.
        shading: its observed radiance and light.
        on_step: called with the number of Gauss-Newton steps done; may raise.

    Returns:
        The mesh with new normals, and how much of the radiance's variation around each vertex is relief, (V,) in 0..1 (`relief_fraction`).
    """
    operators = SurfaceGradient.of(surface)
    irradiance = log_irradiance(shading.irradiance, surface.normals)[0]
    displacement, log_albedo = np.zeros(len(surface.vertices)), shading.log_radiance - irradiance
    relief = relief_fraction(shading.log_radiance.mean(1), irradiance.mean(1), shading.precision > 0, operators)
    deviation = SLOPE_DEVIATION
    for repeated, steps in ((False, range(ITERATIONS)), (True, range(ITERATIONS, ITERATIONS + RELIEF_ITERATIONS))):
        if repeated:
            deviation = slope_deviation(operators.slope(displacement)[shading.precision > 0])
            if deviation <= SLOPE_DEVIATION:
                break
        prior = displacement_prior(operators, deviation, relief)
        for step in steps:
            system = _linearised(surface, shading, operators, prior, displacement, log_albedo, robust=step > 0)
            change = system.solved(CG_ITERATIONS)
            displacement, log_albedo = displacement + change[:, 0], log_albedo + change[:, 1:]
            on_step(min(step + 1, ITERATIONS))
    normals, _ = displaced_normals(surface.normals, operators.slope(displacement))
    return Surface(surface.vertices, normals, surface.faces, surface.voxel), relief


def slope_deviation(slope: np.ndarray) -> float:
    """Return the standard deviation of the gradient that suits a relief: SLOPE_DEVIATION, or more where slopes (V, 3) are large."""
    found = math.sqrt(float((slope**2).sum(1).mean())) if len(slope) else 0.0
    return min(max(SLOPE_DEVIATION, SLOPE_DEVIATION_RATIO * found), MAX_SLOPE_DEVIATION)


def displacement_prior(operators: SurfaceGradient, deviation: float, relief: np.ndarray) -> sparse.csr_matrix:
    """Compute the prior of displacements.

    Args:
        operators: gradient operators of the surface.
        deviation: standard deviation of the displacement's gradient, in edges.
        relief: (V,) 0..1, fractions of the deviations that apply.

    Returns:
        The matrix (V, V) whose quadratic form of a displacement in edges is its negative log prior, times 2.
    """
    precision = sparse.diags(1 / np.maximum(relief, MIN_RELIEF) ** 2)
    bend = sparse.identity(len(relief), format="csr") - operators.average
    slope = sum((matrix.T @ precision @ matrix) / deviation**2 for matrix in operators.gradient)
    return (slope + precision / DISPLACEMENT_DEVIATION**2 + (bend.T @ precision @ bend) / LAPLACIAN_DEVIATION**2).tocsr()


def displaced_normals(normals: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the normals of a displaced surface.

    Args:
        normals: (V, 3) unit normals before.
        slope: (V, 3) gradient of the displacement along them.

    Returns:
        (V, 3) unit normals, and the length (V, 1) before normalisation, at least 1.
    """
    turned = normals - slope + normals * (normals * slope).sum(1, keepdims=True)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    return turned / length, length


def log_irradiance(harmonics: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate log (irradiance / pi).

    Args:
        harmonics: (V, 9, 3), see `DiffuseShading`.
        normals: (V, 3) unit.

    Returns:
        (V, 3) per colour, and its derivative (V, 3, 3) by the normal.
    """
    direction = torch.from_numpy(normals.T.copy()).requires_grad_()
    basis = sh_basis(direction, 2)
    value = torch.einsum("kv,vkc->vc", basis, torch.from_numpy(harmonics).to(basis)).clamp_min(MIN_IRRADIANCE).log()
    slopes = [torch.autograd.grad(value[:, c].sum(), direction, retain_graph=True)[0].T for c in range(3)]
    return value.detach().numpy(), torch.stack(slopes, 1).numpy()


def albedo_weights(log_albedo: np.ndarray, operators: SurfaceGradient) -> np.ndarray:
    """Compute the weights (E,) of differences of log albedo (V, 3) along edges: low where paint is likely, and at large steps."""
    step = operators.difference @ log_albedo
    luminance = step.mean(1)
    chromaticity = ((step - luminance[:, None]) ** 2).sum(1)
    ends = abs(operators.difference).T
    energy = (ends @ chromaticity) / np.maximum(np.asarray(ends.sum(1)).ravel(), 1)
    for _ in range(SPREAD_PASSES):
        energy = energy + SPREAD_FRACTION * (operators.average @ energy - energy)
    variance = ALBEDO_DEVIATION**2 + PAINT_LUMINANCE_RATIO**2 * np.maximum(energy[operators.edges].mean(1) - CHROMATICITY_NOISE**2, 0)
    return 1 / (variance + 3 * luminance**2)


@dataclass(frozen=True, eq=False)
class _System:
    """Gauss-Newton equations of displacement (V,) and log albedo (V, 3): symmetric blocks and the negative gradient (V, 4)."""

    displacement: sparse.csr_matrix  # displacement by displacement
    coupling: list[sparse.csr_matrix]  # displacement by albedo, one per colour
    albedo: sparse.csr_matrix  # albedo by albedo, the same for each colour
    negative_gradient: np.ndarray

    def solved(self, iterations: int) -> np.ndarray:
        """Return the change (V, 4) by preconditioned conjugate gradients."""
        count = len(self.negative_gradient)
        transposed = list(run_jobs(_transposed, [(matrix,) for matrix in self.coupling]))
        diagonal = np.repeat(self.albedo.diagonal()[:, None], 4, 1)
        diagonal[:, 0] = self.displacement.diagonal()
        diagonal = np.maximum(diagonal, 1e-9).ravel()

        def displacement_part(x: np.ndarray) -> np.ndarray:
            return (self.displacement @ x[:, 0] + sum(matrix @ x[:, 1 + c] for c, matrix in enumerate(self.coupling)))[:, None]

        def albedo_part(x: np.ndarray) -> np.ndarray:
            return self.albedo @ x[:, 1:] + np.stack([matrix @ x[:, 0] for matrix in transposed], 1)

        def product(flat: np.ndarray) -> np.ndarray:
            x = flat.reshape(count, 4)
            parts = list(run_jobs(lambda part: part(x), [(displacement_part,), (albedo_part,)]))
            return np.concatenate(parts, 1).ravel()

        shape = (4 * count, 4 * count)
        matrix = LinearOperator(shape, matvec=product, dtype=float)  # type: ignore[call-arg]  # of the subclass that scipy chooses
        preconditioner = LinearOperator(shape, matvec=lambda flat: flat / diagonal, dtype=float)  # type: ignore[call-arg]
        return cg(matrix, self.negative_gradient.ravel(), rtol=CG_TOLERANCE, maxiter=iterations, M=preconditioner)[0].reshape(count, 4)


def _linearised(
    surface: Surface,
    shading: DiffuseShading,
    operators: SurfaceGradient,
    prior: sparse.csr_matrix,
    displacement: np.ndarray,
    log_albedo: np.ndarray,
    *,
    robust: bool,
) -> _System:
    """Linearise the model around a displacement (V,) and log albedo (V, 3), with robust weights of its residuals."""
    normals, length = displaced_normals(surface.normals, operators.slope(displacement))
    value, slope = log_irradiance(shading.irradiance, normals)
    residual = shading.log_radiance - log_albedo - value
    distance = (residual**2).sum(1) * shading.precision / (3 * CAUCHY_SCALE**2)
    weight = sparse.diags(shading.precision / (1 + distance) if robust else shading.precision)
    # The derivative by the slope of the displacement: through the normalisation, then within the tangent plane.
    slope = slope - normals[:, None] * (slope * normals[:, None]).sum(-1, keepdims=True)
    slope = (slope - surface.normals[:, None] * (slope * surface.normals[:, None]).sum(-1, keepdims=True)) / -length[:, None]
    channels = list(run_jobs(_coupled, [(slope[:, c], weight, operators) for c in range(3)]))
    coupling = [matrix for matrix, _ in channels]
    smooth = operators.difference.T @ sparse.diags(albedo_weights(log_albedo, operators)) @ operators.difference
    first = np.asarray(sum(matrix @ residual[:, c] for c, matrix in enumerate(coupling))) - prior @ displacement
    negative_gradient = np.concatenate([first[:, None], weight @ residual - smooth @ log_albedo], 1)
    curvature = prior + sum(block for _, block in channels)
    return _System(curvature.tocsr(), coupling, (smooth + weight).tocsr(), negative_gradient)


def _coupled(slope: np.ndarray, weight: sparse.dia_matrix, operators: SurfaceGradient) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Return the blocks (V, V) of displacement by albedo and of displacement by displacement that one colour's residuals make.

    Args:
        slope: (V, 3) derivative of the log irradiance by the gradient of the displacement.
        weight: (V, V) diagonal weights of the residuals.
        operators: gradient operators of the surface.
    """
    row = sparse.csr_matrix(sum(sparse.diags(slope[:, k]) @ operators.gradient[k] for k in range(3)))
    coupling = (row.T @ weight).tocsr()
    return coupling, coupling @ row


def _transposed(matrix: sparse.csr_matrix) -> sparse.csr_matrix:
    """Return the transpose of a matrix (V, V), by rows."""
    return matrix.T.tocsr()
