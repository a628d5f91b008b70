# SPDX-License-Identifier: GPL-3.0-or-later
"""Grid search of roughness and metallic under a known light, with costs averaged over neighbours of like colour."""

from __future__ import annotations

import copy

import torch

from ....shading.specular_albedo import diffuse_fraction
from .metal_colours import colour_evidence, too_dark
from .metal_cut import COLOUR_PASSES, COLOUR_WEIGHT, MAX_EVIDENCE, NEIGHBOUR_COUPLING, SEARCHED_NORMALS_PRIOR, cut_metal, least_cut
from .metal_normals import turned_metal
from .metal_regions import MIN_SUPPORT_GAIN, SUPPORT_PASSES, connected_regions, grow_metal, neighbourhood, often_seen
from .multi_view_samples import MultiViewSamples
from .parabola import parabola_minimum
from .radiance_transfer import DiffuseRows, RadianceTransfer
from .roughness_prior import with_roughness_prior
from .sample_equation import least_squares_albedo, robust_error, view_terms
from .sample_radiance import SampleRadiance

ROUGHNESS_VALUES = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0)  # searched
NOISE_ERROR = 1.0  # robust error of a view, about, that noise alone makes; the ratio of errors below it tells nothing
METAL_ROUGHNESS_COUNT = 10  # so many of these, the lowest, are searched for a metal; a rougher one looks like a dielectric


class MaterialSearch:
    """Search of the materials of P points with K samples."""

    def __init__(
        self,
        samples: MultiViewSamples,
        transfer: RadianceTransfer,
        diffuse: DiffuseRows,
        colour: torch.Tensor,
        metals: bool = True,
    ) -> None:
        """Find the neighbours.

        Args:
            samples: K samples of P points.
            transfer: radiance transfer to the points.
            diffuse: irradiance of the samples as a function of the light.
            colour: (P, 3) mean linear radiance of the points, by which neighbours are alike.
            metals: points may be metal; otherwise the costs of metals are not computed.
        """
        self.samples, self.transfer, self._diffuse = samples, transfer, diffuse
        self._neighbours, self._similarity = neighbourhood(samples.position, colour)
        self._knots = colour.new_tensor(ROUGHNESS_VALUES)
        self._views = float(samples.lengths.float().mean())
        self._kinds = (0, 1) if metals else (0,)

    def with_transfer(self, transfer: RadianceTransfer, diffuse: DiffuseRows) -> MaterialSearch:
        """Return a search with the transfer from other texels of the light.

        Args:
            transfer: radiance transfer to the points.
            diffuse: irradiance of the samples as a function of the light.
        """
        other = copy.copy(self)
        other.transfer, other._diffuse = transfer, diffuse
        return other

    def costs(self, light: torch.Tensor, weight: torch.Tensor, derivative: torch.Tensor) -> torch.Tensor:
        """Compute the robust error of each point for all materials, with the best albedo for each, averaged over neighbours.

        Args:
            light: (T, 3) linear radiance of the texels.
            weight: (K, 3) of the samples, with which the albedo is fitted.
            derivative: (K, 3) approximate derivative of the sRGB encoding.

        Returns:
            (P, M, J): for a dielectric, and for a metal where there may be any, at each of ROUGHNESS_VALUES.
        """
        samples = self.samples
        f0_term, fresnel_term = self.transfer.sums(samples, self._knots, light)
        irradiance = self._diffuse.irradiance(light)
        cost = light.new_empty(len(samples.position), len(self._kinds), len(self._knots))
        for j, knot in enumerate(self._knots):
            diffuse = diffuse_fraction(samples.n_v, knot.expand_as(samples.n_v))[:, None]
            for metal in self._kinds:
                factor, rest = view_terms(light.new_tensor(metal), diffuse, irradiance, f0_term[:, j], fresnel_term[:, j])
                fit = least_squares_albedo(samples, weight, factor, rest)
                cost[:, metal, j] = robust_error(samples, fit.clamp(0, 1)[samples.point] * factor + rest, derivative)
        return self._smoothed(self._smoothed(cost))

    def roughness(self, costs: torch.Tensor, metal: torch.Tensor) -> torch.Tensor:
        """Return the roughness (P,) of least cost of points that are metal where `metal` (P,) is True."""
        as_metal = parabola_minimum(self._knots[:METAL_ROUGHNESS_COUNT], costs[:, -1, :METAL_ROUGHNESS_COUNT])
        return torch.where(metal, as_metal, parabola_minimum(self._knots, costs[:, 0]))

    def likely_roughness(self, costs: torch.Tensor, metal: torch.Tensor, albedo: torch.Tensor) -> torch.Tensor:
        """Return the most likely roughness (P,) of points; that of dielectrics has a prior, see `with_roughness_prior`.

        Args:
            costs: (P, M, J), see `costs`.
            metal: (P,) bool, the points that are metal.
            albedo: (P, 3) of the points.
        """
        likely = costs.clone()
        likely[~metal, 0] = with_roughness_prior(costs[~metal, 0], albedo[~metal])
        return self.roughness(likely, metal)

    def metal_candidates(self, costs: torch.Tensor) -> torch.Tensor:
        """Find the points (P,) bool that may be metal."""
        return grow_metal(self._gain(costs), self._neighbours, self._similarity)

    def supported(self, candidates: torch.Tensor, gain: torch.Tensor) -> torch.Tensor:
        """Return the candidates (P,) bool without those that gain too little as metal.

        Args:
            candidates: (P,) bool.
            gain: (P,) by how much the robust error falls where all candidates are metal, with a light that has adapted to either.
        """
        for _ in range(SUPPORT_PASSES):
            gain = self._smoothed(gain)
        return candidates & (gain > MIN_SUPPORT_GAIN * self._views)

    def metal_colours(
        self, costs: torch.Tensor, metal: torch.Tensor, light: torch.Tensor, weight: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Compare the points' colours with those of metal, and find points that would be too dark for it; see `metal_colours`.

        Args:
            costs: (P, M, J), see `costs`.
            metal: (P,) bool, metal so far, at least one point.
            light: (T, 3) linear radiance of the texels.
            weight: (K, 3) of the samples, with which the albedo is fitted.

        Returns:
            The evidence for metal (P,), and whether a point is too dark (P,) bool.
        """
        as_metal, as_dielectric = (self._fitted_albedo(costs, light, weight, kind(metal)) for kind in (torch.ones_like, torch.zeros_like))
        return colour_evidence(as_metal, as_dielectric, metal), too_dark(as_metal, metal)

    def redrawn_metal(self, costs: torch.Tensor, metal: torch.Tensor, light: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
        """Redraw the borders of metal by costs that are known better now, see `cut_metal`.

        Args:
            costs: (P, M, J), see `costs`.
            metal: (P,) bool, metal so far.
            light: (T, 3) linear radiance of the texels.
            weight: (K, 3) of the samples, with which the albedo is fitted.
        """
        if not bool(metal.any()):
            return metal
        dielectric, conductor = (least / self._views + NOISE_ERROR for least in self._least(costs))
        dark = too_dark(self._fitted_albedo(costs, light, weight, torch.ones_like(metal)), metal)
        evidence = torch.where(dark, -MAX_EVIDENCE, (dielectric / conductor).log())
        return cut_metal(evidence, metal, self._neighbours, self._similarity)

    def grown_metal(
        self, costs: torch.Tensor, metal: torch.Tensor, light: torch.Tensor, weight: torch.Tensor, surface_normal: torch.Tensor
    ) -> torch.Tensor:
        """Redraw the borders of metal by searched normals and colours, too: wrong normals make a part of it look like a dielectric.

        All points may become metal, since parts that no test has found have the colours of those that were. A metal's error is the
        geometric mean of that with the surface's normal and that with the best one near it. By the latter alone, metal spread to what
        mirrors it. Regions that few views show are dropped.

        Args:
            costs: (P, M, J), see `costs`.
            metal: (P,) bool, metal so far, at least one point.
            light: (T, 3) linear radiance of the texels.
            weight: (K, 3) of the samples, with which the albedo of dielectrics is fitted.
            surface_normal: (P, 3) unit normals of the surface.
        """
        turned, as_metal = turned_metal(self.samples, self.transfer, light, surface_normal, metal)
        dielectric, conductor = (least / self._views + NOISE_ERROR for least in self._least(costs))
        by_error = dielectric.log() - (conductor.log() + (turned + NOISE_ERROR).log()) / 2
        as_dielectric = self._fitted_albedo(costs, light, weight, torch.zeros_like(metal))
        dark, grown = too_dark(as_metal, metal), metal
        for _ in range(COLOUR_PASSES):  # the colours of metal are known better when its borders are
            evidence = by_error + COLOUR_WEIGHT * colour_evidence(as_metal, as_dielectric, grown) + SEARCHED_NORMALS_PRIOR
            grown = least_cut(torch.where(dark, -MAX_EVIDENCE, evidence), self._neighbours, self._similarity, NEIGHBOUR_COUPLING)
        return often_seen(grown, self.samples.lengths, self._neighbours, self._similarity)

    def regions(self, metal: torch.Tensor) -> list[torch.Tensor]:
        """Split points (P,) bool into connected regions, see `connected_regions`."""
        return connected_regions(metal, self._neighbours, self._similarity)

    def _gain(self, costs: torch.Tensor) -> torch.Tensor:
        """Compute by how much less a metal's fit costs than a dielectric's, per view: (P,)."""
        dielectric, metal = self._least(self._smoothed(costs))
        return (dielectric - metal) / self._views

    def _fitted_albedo(self, costs: torch.Tensor, light: torch.Tensor, weight: torch.Tensor, metal: torch.Tensor) -> torch.Tensor:
        """Fit the albedo (P, 3) of points, as metal where `metal` (P,) is True, with the roughness of least cost; see `costs`."""
        roughness = self.roughness(costs, metal)
        radiance = SampleRadiance(self.samples, self.transfer, self._diffuse, roughness, metal.to(roughness))
        return least_squares_albedo(self.samples, weight, *radiance.terms(light))

    @staticmethod
    def _least(costs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the least cost (P,) of each point as a dielectric, and as a metal."""
        dielectric, metal = costs.unbind(1)
        return dielectric.amin(1), metal[:, :METAL_ROUGHNESS_COUNT].amin(1)

    def _smoothed(self, values: torch.Tensor) -> torch.Tensor:
        """Average values (P, ...) over the neighbours of each point, by similarity of colour."""
        return torch.einsum("pn,pn...->p...", self._similarity, values[self._neighbours])
