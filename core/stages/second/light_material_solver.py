# SPDX-License-Identifier: GPL-3.0-or-later
"""Light and material told apart: a bilinear problem, once visibility and indirect light are known.

What view k of point p shows is linear in the light L and, for given roughness and metallic, in the albedo a:

    y_k = a_p c_k + d_k,  c = (1 - m)(1 - E_s) E + m S,  d = 0.04 (1 - m) S + S',

with the irradiance E and both parts S, S' of the specular lobe (core/kernels/lobes.py), each a row times L. Albedo is eliminated
(variable projection, Golub and Pereyra 1973), the light moves by Gauss-Newton steps in its logarithm, roughness and metallic come
from a search over a grid, smoothed among neighbours of like colour. "Light first": albedo starts as one constant for all and is let
go bit by bit, towards few colours; started from the radiance itself it would keep all shading for ever.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.spatial import KDTree

from ...io.srgb import encode_srgb
from ...kernels.jacobian import jacobian
from ...shading.brdf import DIELECTRIC_F0
from ...shading.specular_albedo import diffuse_fraction
from ..common.finite_check import require_finite
from .multi_view_samples import MultiViewSamples
from .radiance_transfer import RadianceTransfer

STEPS = 24
CONSTANT = 3  # steps with one albedo for all
RELEASE = 12  # steps over which the prior of the albedo falls
MATERIAL_STEPS = (8, 12, 16, 20)  # after which steps roughness and metallic are searched
PRIOR = (1.0, 0.01)  # weight of the albedo's prior, from ... to
COLOURS = 0.15  # difference in log albedo below which two points count as of one colour
SAMPLE = 1000  # points that a point's colour is compared with
OUTLIER = 0.02  # encoded difference from which a view loses its say (Cauchy)
SMOOTHNESS = 1e-7  # of the log light, per texel and squared difference
ROUGHNESS = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0)
METALLIC = (0.0, 0.5, 1.0)
HALF_METAL = 0.02  # penalty per view: most things are metal or not
ALBEDO_RANGE = (0.005, 1.5)  # above 1: the light's scale is not known yet
NEIGHBOURS = 13


class LightMaterialSolver:
    """The unknowns and how they are found, from points of which each has at least one view.

    Attributes:
        light: (T, 3) radiance of the texels. albedo: (P, 3). roughness, metallic: (P,).
    """

    def __init__(
        self,
        seen: MultiViewSamples,
        transfer: RadianceTransfer,
        roughness: torch.Tensor,
        metallic: torch.Tensor,
        seed: int,
        metals: Sequence[float] = METALLIC,
    ) -> None:
        """roughness, metallic: (P,) start. metals: values of metallic that are searched."""
        self.seen, self.transfer, self._metals = seen, transfer, seen.colour.new_tensor(metals)
        self.generator = torch.Generator().manual_seed(seed)
        self.roughness, self.metallic = roughness.clone(), metallic.clone()
        mean = seen.sums(seen.colour) / seen.lengths[:, None]
        self.light = mean.new_full((2 * transfer.height**2, 3), 2 * float(mean.mean()))
        self.albedo = torch.full_like(mean, 0.5)
        self.slope = encoding_slope(seen.colour)
        self.trust = torch.ones_like(seen.colour)
        self._smoothness = SMOOTHNESS * _laplacian(transfer.height).to(mean)
        self.n_v = (seen.normal[seen.point] * seen.view).sum(1).clamp_min(1e-3)
        self._start = torch.nn.functional.pad(seen.lengths.cumsum(0), (1, 0))
        self._rows = mean.new_empty(len(seen.point), len(self.light))
        self._neighbours, self._likeness = neighbourhood(seen.position, mean)
        self._trace_lobes()

    def run(self, step: Callable[[int], bool | None] = lambda done: None) -> None:
        """All steps; `step` is told how many are done, may raise, and ends them early by True.

        Raises IrgsppError where an unknown is not finite any more.
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
        """Median of the encoded difference between model and photographs."""
        factor, rest = self._model()
        return float(((self.albedo[self.seen.point] * factor + rest - self.seen.colour) * self.slope).abs().median())

    def _trace_lobes(self) -> None:
        """S and the rows of d, their parts from the object itself, and the coat's share, for the materials as they are."""
        dielectric = DIELECTRIC_F0 * (1 - self.metallic[self.seen.point][:, None])
        self.scaled, added, self.scaled_own, added_own = self.transfer.rows(self.seen, self.roughness)
        self.rest, self.rest_own = added.addcmul_(dielectric, self.scaled), added_own.addcmul_(dielectric, self.scaled_own)
        self.share = diffuse_fraction(self.n_v, self.roughness[self.seen.point])[:, None]

    def _model(self) -> tuple[torch.Tensor, torch.Tensor]:
        """c and d (K, 3)."""
        point, metal = self.seen.point, self.metallic[self.seen.point][:, None]
        irradiance = (self.transfer.irradiance @ self.light + self.transfer.indirect)[point]
        specular = self.scaled @ self.light + self.scaled_own
        return (1 - metal) * self.share * irradiance + metal * specular, self.rest @ self.light + self.rest_own

    def _step(self, done: int) -> None:
        """Albedo for this light, then the light for whatever albedo that makes."""
        seen, y = self.seen, self.seen.colour
        factor, rest = self._model()
        error = (self.albedo[seen.point] * factor + rest - y) * self.slope
        trust = 1 / (1 + (error / OUTLIER) ** 2) if done >= CONSTANT else torch.ones_like(error)
        self.trust = torch.where(seen.saturated & (error > 0), 0.0, trust)  # a clipped highlight is a lower bound
        weight = self.trust * self.slope**2
        anchor, pull = self._albedo_prior(done)
        total = seen.sums(weight * factor * factor) + pull
        self.albedo = ((seen.sums(weight * factor * (y - rest)) + pull * anchor) / total).clamp(*ALBEDO_RANGE)
        residual = self.albedo[seen.point] * factor + rest - y
        self.light = torch.stack([self._moved(c, weight[:, c], factor[:, c], total[:, c], residual[:, c]) for c in range(3)], 1)

    def _moved(self, channel: int, weight: torch.Tensor, factor: torch.Tensor, total: torch.Tensor, residual: torch.Tensor) -> torch.Tensor:
        """(T,) one channel of the light after a Gauss-Newton step; the albedo follows the light (Schur complement)."""
        light = self.light[:, channel]
        normal, slope = self._equations(channel, weight, factor, total, residual)
        normal, slope = light[:, None] * normal * light, light * slope  # by the logarithm of the light
        damped = normal + self._smoothness + torch.diag(1e-3 * normal.diagonal() + 1e-10)
        log_light = light.log()
        step = torch.linalg.solve(damped.double(), (slope + self._smoothness @ log_light).double()).float()
        return (log_light - step.clamp(-1, 1)).clamp(-9, 7).exp()

    def _equations(
        self, channel: int, weight: torch.Tensor, factor: torch.Tensor, total: torch.Tensor, residual: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Hessian (T, T) and gradient (T,) of the squared error by one channel of the light, albedo eliminated, per view.

        weight, factor, residual: (K,) of the views. total: (P,) curvature of the error by each albedo.
        """
        point, albedo = self.seen.point, self.albedo[self.seen.point, channel]
        metal = self.metallic[point]
        root = weight.sqrt()
        views = (root, weight * factor / total.sqrt()[point], albedo * (1 - metal) * self.share[:, 0], albedo * metal)
        matrices = (self.transfer.irradiance, self.scaled, self.rest, self._rows)
        start, root_too, share, *factors = self.transfer.arrays(self._start, *(v.contiguous() for v in views))
        *transport, rows = self.transfer.arrays(*matrices)
        coupling = jacobian(start, root_too, share, (factors[0], factors[1]), (transport[0], transport[1], transport[2]), rows)
        normal = gram(self._rows) - gram(torch.as_tensor(coupling))
        return normal / len(weight), self._rows.T @ (root * residual) / len(weight)

    def _albedo_prior(self, done: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Where each albedo is drawn to, (P, 3), and how strongly: the mean of those like it (mean shift among few colours)."""
        if done < CONSTANT:
            return torch.full_like(self.albedo, 0.5), torch.full_like(self.albedo, 1e3)
        log_albedo = self.albedo.log()
        others = log_albedo[torch.randperm(len(log_albedo), generator=self.generator)[:SAMPLE].to(log_albedo.device)]
        like = 1 / (1 + torch.cdist(log_albedo, others).square() / COLOURS**2) ** 2
        share = like.sum(1, keepdim=True)
        strength = PRIOR[0] * (PRIOR[1] / PRIOR[0]) ** min(1.0, (done - CONSTANT) / RELEASE)
        pull = strength * share / len(others) / self.albedo.clamp_min(0.02) ** 2 + 1e-6
        return (like @ others / share).exp(), pull

    def _search_materials(self) -> None:
        """Roughness and metallic that explain all views of a point and its neighbours best, each candidate with its own best albedo."""
        knots, metals = self._metals.new_tensor(ROUGHNESS), self._metals
        cost = self._costs(knots, metals)
        for _ in range(2):
            cost = torch.einsum("pn,pnmr->pmr", self._likeness, cost[self._neighbours])
        best, _ = cost.min(2)
        best = best + (metals % 1 > 0) * HALF_METAL * float(self.seen.lengths.float().mean())
        metal = best.argmin(1)
        self.metallic = metals[metal]
        self.roughness = _vertex(knots, cost[torch.arange(len(cost), device=cost.device), metal])
        self._trace_lobes()

    def _costs(self, knots: torch.Tensor, metals: torch.Tensor) -> torch.Tensor:
        """(P, metals, knots) robust error summed over views."""
        seen = self.seen
        scaled, added = self.transfer.sums(seen, knots, self.light)
        irradiance = (self.transfer.irradiance @ self.light + self.transfer.indirect)[seen.point]
        weight = self.trust * self.slope**2
        cost = metals.new_empty(len(seen.position), len(metals), len(knots))
        for j, knot in enumerate(knots):
            share = diffuse_fraction(self.n_v, knot.expand_as(self.n_v))[:, None]
            for i, metal in enumerate(metals):
                factor, rest = view_terms(metal, share, irradiance, scaled[:, j], added[:, j])
                fit = seen.sums(weight * factor * (seen.colour - rest)) / seen.sums(weight * factor * factor).clamp_min(1e-9)
                error = (fit.clamp(0, 1)[seen.point] * factor + rest - seen.colour) * self.slope
                error = torch.where(seen.saturated & (error > 0), 0.0, error)
                cost[:, i, j] = seen.sums(torch.log1p((error / OUTLIER) ** 2).sum(1))
        return cost


def view_terms(
    metallic: torch.Tensor, share: torch.Tensor, irradiance: torch.Tensor, scaled: torch.Tensor, added: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """c and d of y = a c + d, (K, 3), from metallic and the coat's share, (K, 1) or scalars, E, S and S', (K, 3)."""
    return (1 - metallic) * share * irradiance + metallic * scaled, DIELECTRIC_F0 * (1 - metallic) * scaled + added


def encoding_slope(colour: torch.Tensor) -> torch.Tensor:
    """Slope of the sRGB curve at linear colours, about: with it errors count as they are seen."""
    return 0.44 / colour.clamp_min(3e-3) ** 0.58


def neighbourhood(position: torch.Tensor, colour: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The nearest NEIGHBOURS of each point, itself among them, (P, N), and their shares by likeness of colour (P, N), which sum to 1."""
    places = position.cpu().numpy()
    _, nearest = KDTree(places).query(places, k=min(NEIGHBOURS, len(places)))
    index = torch.from_numpy(np.asarray(nearest).reshape(len(places), -1)).to(position.device)
    hue, shade = colour / (colour.sum(1, keepdim=True) + 0.02), encode_srgb(colour)
    apart = 15 * (hue[:, None] - hue[index]).abs().sum(-1) + 3 * (shade[:, None] - shade[index]).abs().sum(-1)
    like = torch.exp(-apart)
    return index, like / like.sum(1, keepdim=True)


def gram(rows: torch.Tensor) -> torch.Tensor:
    """(T, T) rows^T rows of (K, T): upper blocks only, mirrored."""
    width = rows.shape[1]
    form, block = rows.new_zeros(width, width), max(64, width // 8)
    for begin in range(0, width, block):
        form[begin : begin + block, begin:] = rows[:, begin : begin + block].T @ rows[:, begin:]
    return form.triu() + form.triu(1).T


def _vertex(knots: torch.Tensor, cost: torch.Tensor) -> torch.Tensor:
    """(P,) the knot of least cost (P, J), moved to the vertex of the parabola through it and its neighbours."""
    row, j = torch.arange(len(cost), device=cost.device), cost.argmin(1).clamp(1, len(knots) - 2)
    below, least, above = cost[row, j - 1], cost[row, j], cost[row, j + 1]
    shift = ((below - above) / (2 * (below - 2 * least + above)).clamp_min(1e-6)).clamp(-1, 1)
    return knots[j] + torch.where(shift < 0, shift * (knots[j] - knots[j - 1]), shift * (knots[j + 1] - knots[j]))


def _laplacian(height: int) -> torch.Tensor:
    """(T, T) sum of squared differences between neighbours of a lat-long map of so many rows, as a quadratic form."""
    index = torch.arange(2 * height * height).view(height, -1)
    pairs = torch.cat([torch.stack([index, index.roll(-1, 1)], -1).view(-1, 2), torch.stack([index[:-1], index[1:]], -1).view(-1, 2)])
    form = torch.zeros(index.numel(), index.numel())
    form.view(-1).index_add_(0, pairs[:, 0] * index.numel() + pairs[:, 1], torch.ones(len(pairs)))
    off = form + form.T
    return torch.diag(off.sum(1)) - off
