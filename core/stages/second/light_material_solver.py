# SPDX-License-Identifier: GPL-3.0-or-later
"""Light-material solver: environment light, albedo, roughness and metallic from multi-view samples.

With visibility and indirect light known, the problem is bilinear. The radiance of view k of point p is linear in the light L and, for
given roughness and metallic, in the albedo a:

    y_k = a_p c_k + d_k,  c = (1 - m)(1 - E_s) E + m S,  d = 0.04 (1 - m) S + S',

where E is irradiance / pi, E_s the specular albedo of a dielectric coat, and S, S' are the parts of the specular lobe that F0 scales
and that Fresnel adds (core/kernels/lobes.py). E, S and S' are each a row times L plus a constant from indirect light. The albedo is
eliminated in closed form (variable projection, Golub and Pereyra 1973), the logarithm of the light takes Gauss-Newton steps, and
roughness and metallic come from a grid search that is smoothed among neighbours of similar colour (metal: `material_regions.py`).

"Light first": the albedo starts as one constant for all points and is released gradually, towards few colours; an albedo that starts
from the radiance itself would keep all shading.
"""

from __future__ import annotations

from collections.abc import Callable

import torch

from ...kernels.jacobian import jacobian
from ...shading.brdf import DIELECTRIC_F0
from ...shading.specular_albedo import diffuse_fraction
from ..common.finite_check import require_finite
from .light_prior import LightPrior
from .material_regions import metal_regions, neighbourhood
from .multi_view_samples import MultiViewSamples
from .radiance_transfer import RadianceTransfer

STEPS = 40
CONSTANT = 3  # steps with one albedo for all points
RELEASE = 12  # steps over which the weight of the albedo's prior falls
MATERIAL_STEPS = (8, 12, 16, 20, 28, 36)  # numbers of steps done when roughness and metallic are searched
PRIOR = (1.0, 0.03)  # first and last weight of the albedo's prior
COLOURS = 0.15  # difference in log albedo below which two points count as being of one colour
SAMPLE = 1000  # points that each point's colour is compared with
OUTLIER = 0.02  # encoded difference at which a sample's robust weight is halved (Cauchy)
ROUGHNESS_VALUES = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0)  # searched
METAL_ROUGHNESS = 10  # so many of these, the lowest, are searched for a metal; a rougher one looks like a dielectric
ALBEDO_RANGE = (0.005, 1.5)  # above 1, as the scale of the light is not known yet


class LightMaterialSolver:
    """Solver with its current estimates; each point needs at least one sample.

    Attributes:
        samples: multi-view samples of P points, K in all.
        transfer: radiance transfer from T texels to the points.
        light: (T, 3) linear radiance of the texels.
        albedo: (P, 3).
        roughness: (P,).
        metallic: (P,).
        derivative: (K, 3) approximate derivative of the sRGB encoding at the samples' radiance.
        robust_weight: (K, 3) weights of the last step in 0..1.
    """

    def __init__(
        self,
        samples: MultiViewSamples,
        transfer: RadianceTransfer,
        roughness: torch.Tensor,
        metallic: torch.Tensor,
        seed: int,
        search_metal: bool = True,
    ) -> None:
        """Start with a constant albedo of 0.5 and a constant light.

        Args:
            samples: multi-view samples of P points.
            transfer: radiance transfer to the points.
            roughness: (P,) initial values.
            metallic: (P,) initial values.
            seed: of the points that colours are compared with.
            search_metal: some points may be metal; otherwise none is.
        """
        self.samples, self.transfer, self._search_metal, self._searches = samples, transfer, search_metal, 0
        self.generator = torch.Generator().manual_seed(seed)
        self.roughness, self.metallic = roughness.clone(), metallic.clone()
        mean = samples.sums(samples.colour) / samples.lengths[:, None]
        self.light = mean.new_full((2 * transfer.height**2, 3), 2 * float(mean.mean()))
        self.albedo = torch.full_like(mean, 0.5)
        self.derivative = approximate_srgb_derivative(samples.colour)
        self.robust_weight = torch.ones_like(samples.colour)
        self._light_prior = LightPrior(transfer.height, mean.device)
        self.n_v = (samples.normal[samples.point] * samples.view).sum(1).clamp_min(1e-3)
        self._start = torch.nn.functional.pad(samples.lengths.cumsum(0), (1, 0))
        self._rows = mean.new_empty(len(samples.point), len(self.light))
        self._neighbours, self._similarity = neighbourhood(samples.position, mean)
        self._diffuse = transfer.diffuse_rows(samples)
        self._trace_lobes()

    def run(self, step: Callable[[int], bool | None] = lambda done: None) -> None:
        """Do all steps.

        Args:
            step: called with the number of steps done; it may raise, and ends the run early by returning True.

        Raises:
            IrgsppError: an estimate is not finite.
        """
        for done in range(STEPS):
            if done in MATERIAL_STEPS:
                self._search_materials()
            self._step(done)
            unknowns = {name: getattr(self, name) for name in ("light", "albedo", "roughness", "metallic")}
            require_finite(unknowns, f"after step {done + 1} of the second stage")
            if step(done + 1):
                break

    def error(self) -> float:
        """Return the median difference between model and images, approximately in encoded values 0..1."""
        factor, rest = self._model()
        return float(((self.albedo[self.samples.point] * factor + rest - self.samples.colour) * self.derivative).abs().median())

    def _trace_lobes(self) -> None:
        """Compute, for the current materials, S and d as rows of the light (K, T), their indirect parts (K, 3), and 1 - E_s (K, 1)."""
        dielectric = DIELECTRIC_F0 * (1 - self.metallic[self.samples.point][:, None])
        self.scaled, added, self.scaled_own, added_own = self.transfer.rows(self.samples, self.roughness)
        self.rest, self.rest_own = added.addcmul_(dielectric, self.scaled), added_own.addcmul_(dielectric, self.scaled_own)
        self.diffuse_fraction = diffuse_fraction(self.n_v, self.roughness[self.samples.point])[:, None]

    def _model(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Evaluate c and d of y = a c + d, (K, 3) each."""
        metal, irradiance = self.metallic[self.samples.point][:, None], self._diffuse.irradiance(self.light)
        specular = self.scaled @ self.light + self.scaled_own
        return (1 - metal) * self.diffuse_fraction * irradiance + metal * specular, self.rest @ self.light + self.rest_own

    def _step(self, done: int) -> None:
        """Solve the albedo for the current light, then do a Gauss-Newton step of the light with the albedo eliminated."""
        samples, y = self.samples, self.samples.colour
        factor, rest = self._model()
        error = (self.albedo[samples.point] * factor + rest - y) * self.derivative
        robust = 1 / (1 + (error / OUTLIER) ** 2) if done >= CONSTANT else torch.ones_like(error)
        self.robust_weight = torch.where(samples.saturated & (error > 0), 0.0, robust)  # a clipped highlight is a lower bound
        weight = self.robust_weight * self.derivative**2
        anchor, pull = self._albedo_prior(done)
        total = samples.sums(weight * factor * factor) + pull
        self.albedo = ((samples.sums(weight * factor * (y - rest)) + pull * anchor) / total).clamp(*ALBEDO_RANGE)
        residual, smoothness = self.albedo[samples.point] * factor + rest - y, self._light_prior.form(self.light)
        channels = [(weight[:, c], factor[:, c], total[:, c], residual[:, c]) for c in range(3)]
        self.light = torch.stack([self._step_light(c, *channel, smoothness) for c, channel in enumerate(channels)], 1)

    def _step_light(
        self,
        channel: int,
        weight: torch.Tensor,
        factor: torch.Tensor,
        total: torch.Tensor,
        residual: torch.Tensor,
        smoothness: torch.Tensor,
    ) -> torch.Tensor:
        """Return one channel (T,) of the light after a damped Gauss-Newton step; the albedo follows the light (Schur complement)."""
        light = self.light[:, channel]
        hessian, gradient = self._equations(channel, weight, factor, total, residual)
        hessian, gradient = light[:, None] * hessian * light, light * gradient  # with respect to the logarithm of the light
        damped = hessian + smoothness + torch.diag(1e-3 * hessian.diagonal() + 1e-10)
        log_light = light.log()
        step = torch.linalg.solve(damped.double(), (gradient + smoothness @ log_light).double()).float()
        return (log_light - step.clamp(-1, 1)).clamp(-9, 7).exp()

    def _equations(
        self, channel: int, weight: torch.Tensor, factor: torch.Tensor, total: torch.Tensor, residual: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the Gauss-Newton Hessian (T, T) and gradient (T,) of half the mean squared error in the light, albedo eliminated.

        For one channel: weight, factor c and residual (K,) of the samples; `total` (P,), the error's curvature in each albedo.
        """
        point, albedo = self.samples.point, self.albedo[self.samples.point, channel]
        metal = self.metallic[point]
        root = weight.sqrt()
        diffuse, specular, scaled = albedo * (1 - metal) * self.diffuse_fraction[:, 0], albedo * metal, self.scaled
        if self.transfer.rotations is not None:  # the irradiance is that of the sample, not of its point
            scaled = (diffuse[:, None] * self._diffuse.rows).addcmul_(specular[:, None], scaled)
            diffuse, specular = torch.zeros_like(diffuse), torch.ones_like(specular)
        views = (root, weight * factor / total.sqrt()[point], diffuse, specular)
        matrices = (self.transfer.irradiance, scaled, self.rest, self._rows)
        start, root_weight, coupling_weight, *factors = self.transfer.arrays(self._start, *(v.contiguous() for v in views))
        *transport, rows = self.transfer.arrays(*matrices)
        coupling = jacobian(start, root_weight, coupling_weight, (factors[0], factors[1]), (transport[0], transport[1], transport[2]), rows)
        hessian = gram(self._rows) - gram(torch.as_tensor(coupling))
        return hessian / len(weight), self._rows.T @ (root * residual) / len(weight)

    def _albedo_prior(self, done: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return target and weight (P, 3) of the albedo's prior: the mean of similar albedos (mean shift towards few colours)."""
        if done < CONSTANT:
            return torch.full_like(self.albedo, 0.5), torch.full_like(self.albedo, 1e3)
        log_albedo = self.albedo.log()
        others = log_albedo[torch.randperm(len(log_albedo), generator=self.generator)[:SAMPLE].to(log_albedo.device)]
        similarity = 1 / (1 + torch.cdist(log_albedo, others).square() / COLOURS**2) ** 2
        total = similarity.sum(1, keepdim=True)
        strength = PRIOR[0] * (PRIOR[1] / PRIOR[0]) ** min(1.0, (done - CONSTANT) / RELEASE)
        pull = strength * total / len(others) / self.albedo.clamp_min(0.02) ** 2 + 1e-6
        return (similarity @ others / total).exp(), pull

    def _search_materials(self) -> None:
        """Set roughness and metallic to the values with the least error over a point and its neighbours, each with its best albedo."""
        knots = self.roughness.new_tensor(ROUGHNESS_VALUES)
        metallic = self.roughness.new_tensor((0.0, 1.0) if self._search_metal else (0.0,))
        cost = self._smoothed(self._smoothed(self._costs(knots, metallic)))
        self.roughness = _vertex(knots, cost[:, 0])
        if self._search_metal:
            dielectric, metal = self._smoothed(cost).unbind(1)
            gain = (dielectric.amin(1) - metal[:, :METAL_ROUGHNESS].amin(1)) / self.samples.lengths.float().mean()
            last = self.metallic > 0 if self._searches else None
            found = metal_regions(gain, self._neighbours, self._similarity, last, self._searches)
            self._searches += 1
            self.metallic = found.to(self.metallic)
            self.roughness = torch.where(found, _vertex(knots[:METAL_ROUGHNESS], cost[:, 1, :METAL_ROUGHNESS]), self.roughness)
        else:
            self.metallic = torch.zeros_like(self.metallic)
        self._trace_lobes()

    def _smoothed(self, cost: torch.Tensor) -> torch.Tensor:
        """Average costs (P, metallic values, roughness knots) over the neighbours of each point, by similarity of colour."""
        return torch.einsum("pn,pnmr->pmr", self._similarity, cost[self._neighbours])

    def _costs(self, knots: torch.Tensor, metallic_values: torch.Tensor) -> torch.Tensor:
        """Return the robust error (P, metallic values, roughness knots), summed over the samples of each point."""
        samples = self.samples
        scaled, added = self.transfer.sums(samples, knots, self.light)
        irradiance = self._diffuse.irradiance(self.light)
        weight = self.robust_weight * self.derivative**2
        cost = metallic_values.new_empty(len(samples.position), len(metallic_values), len(knots))
        for j, knot in enumerate(knots):
            diffuse = diffuse_fraction(self.n_v, knot.expand_as(self.n_v))[:, None]
            for i, metal in enumerate(metallic_values):
                factor, rest = view_terms(metal, diffuse, irradiance, scaled[:, j], added[:, j])
                fit = samples.sums(weight * factor * (samples.colour - rest)) / samples.sums(weight * factor * factor).clamp_min(1e-9)
                error = (fit.clamp(0, 1)[samples.point] * factor + rest - samples.colour) * self.derivative
                error = torch.where(samples.saturated & (error > 0), 0.0, error)
                cost[:, i, j] = samples.sums(torch.log1p((error / OUTLIER) ** 2).sum(1))
        return cost


def view_terms(
    metallic: torch.Tensor, diffuse: torch.Tensor, irradiance: torch.Tensor, scaled: torch.Tensor, added: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Evaluate c and d of y = a c + d.

    Args:
        metallic: m, (K, 1) or scalar.
        diffuse: 1 - E_s, see `diffuse_fraction`, (K, 1) or scalar.
        irradiance: E, irradiance / pi, (K, 3).
        scaled: S, the part of the specular lobe that F0 scales, (K, 3).
        added: S', the part that Fresnel adds, (K, 3).

    Returns:
        c and d, (K, 3) each.
    """
    return (1 - metallic) * diffuse * irradiance + metallic * scaled, DIELECTRIC_F0 * (1 - metallic) * scaled + added


def approximate_srgb_derivative(colour: torch.Tensor) -> torch.Tensor:
    """Approximate the derivative of the sRGB encoding by its power law, so that errors count as encoded differences.

    Unlike the exact derivative in `core.relight.adaptive_sampling`, it is constant below 0.003 and does not vanish above 1.

    Args:
        colour: (...,) linear.
    """
    return 0.44 / colour.clamp_min(3e-3) ** 0.58


def gram(rows: torch.Tensor) -> torch.Tensor:
    """Compute the Gram matrix (T, T) of rows (K, T), rows^T rows, by its upper blocks only."""
    width = rows.shape[1]
    form, block = rows.new_zeros(width, width), max(64, width // 8)
    for begin in range(0, width, block):
        form[begin : begin + block, begin:] = rows[:, begin : begin + block].T @ rows[:, begin:]
    return form.triu() + form.triu(1).T


def _vertex(knots: torch.Tensor, cost: torch.Tensor) -> torch.Tensor:
    """Return the (P,) minimum of costs (P, J) at knots (J,): the vertex of the parabola through the least cost and its neighbours."""
    row, j = torch.arange(len(cost), device=cost.device), cost.argmin(1).clamp(1, len(knots) - 2)
    below, least, above = cost[row, j - 1], cost[row, j], cost[row, j + 1]
    shift = ((below - above) / (2 * (below - 2 * least + above)).clamp_min(1e-6)).clamp(-1, 1)
    return knots[j] + torch.where(shift < 0, shift * (knots[j] - knots[j - 1]), shift * (knots[j + 1] - knots[j]))
