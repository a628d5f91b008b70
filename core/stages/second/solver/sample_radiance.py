# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of samples as a function of the light, for fixed materials: y = a c + d, and its derivatives by the light."""

from __future__ import annotations

import torch

from ....kernels.jacobian import gram, jacobian
from ....shading.brdf import DIELECTRIC_F0
from ....shading.specular_albedo import diffuse_fraction
from .multi_view_samples import MultiViewSamples
from .radiance_transfer import DiffuseRows, RadianceTransfer


class SampleRadiance:
    """Radiance y = a c + d of K samples of P points, whose c and d are linear in the light (T, 3); a is the albedo of a point.

    Attributes:
        diffuse_share: (1 - m)(1 - E_s), (K, 1).
        metal: m, (K, 1).
        f0_term: S, the scale of F0 in the split-sum form F0 S + S', as rows of the light, (K, T).
        rest: d as rows of the light, (K, T).
    """

    def __init__(
        self,
        samples: MultiViewSamples,
        transfer: RadianceTransfer,
        diffuse: DiffuseRows,
        roughness: torch.Tensor,
        metallic: torch.Tensor,
    ) -> None:
        """Compute the rows of the lobes.

        Args:
            samples: K samples of P points.
            transfer: radiance transfer to the points.
            diffuse: irradiance of the samples as a function of the light.
            roughness: (P,).
            metallic: (P,).
        """
        self._samples, self._transfer, self._diffuse = samples, transfer, diffuse
        self.metal = metallic[samples.point][:, None]
        self.diffuse_share = (1 - self.metal) * diffuse_fraction(samples.n_v, roughness[samples.point])[:, None]
        dielectric = DIELECTRIC_F0 * (1 - self.metal)
        self.f0_term, fresnel_term, self._f0_indirect, fresnel_indirect = transfer.rows(samples, roughness)
        self.rest = fresnel_term.addcmul_(dielectric, self.f0_term)
        self._rest_indirect = fresnel_indirect.addcmul_(dielectric, self._f0_indirect)

    def terms(self, light: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Evaluate c and d, (K, 3) each, under a light (T, 3)."""
        specular = self.f0_term @ light + self._f0_indirect
        return self.diffuse_share * self._diffuse.irradiance(light) + self.metal * specular, self.rest @ light + self._rest_indirect

    def gradient(self, albedo: torch.Tensor, residual: torch.Tensor) -> torch.Tensor:
        """Return the gradient (T, 3) of half the mean squared error in the light.

        Args:
            albedo: (P, 3) that minimises the error, so that its own change counts for nothing.
            residual: (K, 3) of the radiance, times the weights of its squares.
        """
        by_factor = residual * albedo[self._samples.point]
        gradient = (residual.T @ self.rest).T + self._diffuse.transposed(self.diffuse_share * by_factor)
        if bool(self.metal.any()):
            gradient += ((self.metal * by_factor).T @ self.f0_term).T
        return gradient / len(residual)

    def hessian(self, albedo: torch.Tensor, weight: torch.Tensor, factor: torch.Tensor, curvature: torch.Tensor) -> list[torch.Tensor]:
        """Return the Gauss-Newton Hessian (T, T) of each channel of half the mean squared error in the light, albedo eliminated.

        Args:
            albedo: (P, 3).
            weight: (K, 3) of the squared residuals.
            factor: c, (K, 3).
            curvature: (P, 3) of the error in each albedo.
        """
        rows = torch.empty_like(self.rest)
        return [self._hessian(rows, *(values[:, c] for values in (albedo, weight, factor, curvature))) for c in range(3)]

    def _hessian(
        self, rows: torch.Tensor, albedo: torch.Tensor, weight: torch.Tensor, factor: torch.Tensor, curvature: torch.Tensor
    ) -> torch.Tensor:
        """Return the Hessian (T, T) of one channel: a Schur complement. `rows` (K, T) is overwritten."""
        point, arrays = self._samples.point, self._transfer.arrays
        by_point = albedo[point]
        diffuse, specular, rows_of_factor = by_point * self.diffuse_share[:, 0], by_point * self.metal[:, 0], self.f0_term
        if self._transfer.rotations is not None:  # the irradiance is that of the sample, not of its point
            rows_of_factor = (diffuse[:, None] * self._diffuse.rows).addcmul_(specular[:, None], rows_of_factor)
            diffuse, specular = torch.zeros_like(diffuse), torch.ones_like(specular)
        start = torch.nn.functional.pad(self._samples.lengths.cumsum(0), (1, 0))
        views = (weight.sqrt(), weight * factor / curvature.sqrt()[point], diffuse, specular)
        begin, root_weight, coupling_weight, *factors = arrays(start, *(values.contiguous() for values in views))
        *transport, out = arrays(self._transfer.irradiance, rows_of_factor, self.rest, rows)
        coupling = jacobian(begin, root_weight, coupling_weight, (factors[0], factors[1]), (transport[0], transport[1], transport[2]), out)
        return (gram(rows) - gram(torch.as_tensor(coupling))) / len(weight)
