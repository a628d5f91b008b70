# SPDX-License-Identifier: GPL-3.0-or-later
"""Light-material solver: environment light, albedo, roughness and metallic from multi-view samples.

With visibility and indirect light known, the problem is bilinear. The radiance of view k of point p is linear in the light L and, for
given roughness and metallic, in the albedo a:

    y_k = a_p c_k + d_k,  c = (1 - m)(1 - E_s) E + m S,  d = 0.04 (1 - m) S + S',

where E is irradiance / pi, E_s the specular albedo of a dielectric coat, and F0 S + S' the specular lobe in split-sum form: S is its
scale (`f0_term`), S' its bias (`fresnel_term`; core/kernels/lobes.py). E, S and S' are each a row times L plus a constant from indirect
light. The albedo is eliminated in closed form (variable projection, Golub and Pereyra 1973), the logarithm of the light takes
Gauss-Newton steps, roughness and metallic come from a grid search, smoothed among neighbours of similar colour (`metal_regions`). At the
end normals of metal turn towards its reflections (`metal_normals`), and roughness and light settle (`roughness_prior`).

"Light first": the albedo starts as one constant and is released gradually, towards few colours. Else it would keep all shading.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from ...common.finite_check import require_finite
from .albedo_prior import ALBEDO_RANGE, CONSTANT_STEPS, DARK_ALBEDO, MEDIUM_ALBEDO, SETTLING_WEIGHT, albedo_prior
from .light_prior import LightPrior
from .linear_system import damped_step
from .material_search import MaterialSearch
from .metal_confirmation import Hypothesis, completed_metal, confirm_metal, measured_regions
from .metal_normals import metal_trust, reflected_normals
from .multi_view_samples import MultiViewSamples
from .radiance_transfer import RadianceTransfer
from .sample_equation import CAUCHY_SCALE, approximate_srgb_derivative, robust_error
from .sample_radiance import SampleRadiance
from .seen_light import SeenLight

STEPS = 44  # Gauss-Newton steps of the light; all else is scheduled by the number of steps done
MATERIAL_STEPS = (8, 12, 16, 20, 28, 36, 38)  # roughness and metallic are searched when so many steps are done
METAL_TEST_STEP = 28  # one of these, at which the candidates for metal are tested instead; points join them before it
METAL_BORDERS_STEP = 38  # one of these, at which the borders of metal are drawn anew: the light has adapted to the metal by then
TEST_STEPS = 8  # steps in which the light adapts to each hypothesis of the test: after 4, some have hardly begun to
# A Hessian costs most of a step. It counts for so many, while materials stay, the error falls, and the last step changed the log light by
# less than MAX_HESSIAN_STEP (root mean square): with older ones, the solver found none of the metal on rocker_corner.
MAX_HESSIAN_AGE, MAX_HESSIAN_STEP = 4, 0.15
# Factor of CAUCHY_SCALE after a split of the light, which halves with each step: at first, highlights would count as outliers.
SPLIT_CAUCHY_FACTOR = 4.0
TURN_STEPS, SETTLING_STEPS = 4, 2  # steps in which the light follows turned normals of metal, and each search of the roughness at the end
LOG_LIGHT_RANGE = (-9, 7)  # of a texel's log radiance
Split = Callable[[RadianceTransfer, torch.Tensor], tuple[RadianceTransfer, np.ndarray]]  # see `split_brightest`


class LightMaterialSolver:
    """Solver with its current estimates; each point needs at least one sample.

    Attributes:
        samples: multi-view samples of P points, K in all; normals of metal turn at the end.
        surface_normal: (P, 3) unit, of the samples at the start.
        transfer: radiance transfer from T texels to the points.
        light: (T, 3) linear radiance of the texels.
        albedo, roughness, metallic: (P, 3), (P,) and (P,).
        derivative: (K, 3) approximate derivative of the sRGB encoding at the samples' radiance.
        robust_weight: (K, 3) weights of the last step in 0..1.
        candidates: (P,) bool, points that a search found to be metal before the test.
        start_albedo: albedo of all points in the first steps: MEDIUM_ALBEDO, or DARK_ALBEDO where that explained the photographs better.
        started_glossy: it started once more from a glossy surface, see `solver_run`.
        regions: number of regions of candidates, and of those that are metal.
        metal_gain: share of the robust error that the metal regions explained in their test, 0..1.
    """

    def __init__(
        self,
        samples: MultiViewSamples,
        transfer: RadianceTransfer,
        roughness: torch.Tensor,
        metallic: torch.Tensor,
        seed: int,
        search_metal: bool = True,
        seen: SeenLight | None = None,
    ) -> None:
        """Start with a medium constant albedo and a constant light.

        Args:
            samples: multi-view samples of P points.
            transfer: radiance transfer to the points.
            roughness: (P,) initial values.
            metallic: (P,) initial values.
            seed: seed of the random selection of points that colours are compared with.
            search_metal: some points may be metal; otherwise none is.
            seen: light that the photographs show directly; None for none.
        """
        self.samples, self.transfer, self._search_metal, self._seed, self._seen = samples, transfer, search_metal, seed, seen
        self.surface_normal, self.generator = samples.normal, torch.Generator().manual_seed(seed)
        self.roughness, self.metallic = roughness.clone(), metallic.clone()
        mean = samples.sums(samples.colour) / samples.lengths[:, None]
        self.light = mean.new_full((transfer.texels.count, 3), float(mean.mean()) / MEDIUM_ALBEDO)
        self.albedo, self.start_albedo, self.started_glossy = torch.full_like(mean, MEDIUM_ALBEDO), MEDIUM_ALBEDO, False
        self.derivative, self.robust_weight = approximate_srgb_derivative(samples.colour), torch.ones_like(samples.colour)
        self._light_prior = LightPrior(transfer.texels, mean.device, seen)
        self._diffuse = transfer.diffuse_rows(samples)
        self._search = MaterialSearch(samples, transfer, self._diffuse, mean, search_metal)
        self.candidates, self.regions, self.metal_gain = torch.zeros_like(metallic, dtype=torch.bool), (0, 0), 0.0
        self._curvature, self._trust = mean.new_zeros(3), mean.new_ones(len(mean))  # see `damped_step`, `metal_trust`
        self._moved, self._loosened = math.inf, 1.0  # root mean square of the last step of the log light; next factor of CAUCHY_SCALE
        self._update_model()

    @property
    def is_all_metal(self) -> bool:
        """True where all points are metal."""
        return bool((self.metallic > 0).all())

    def advance(self, done: int) -> None:
        """Search the materials where it is time, and do a step.

        Args:
            done: number of steps done.

        Raises:
            IrgsppError: an estimate is not finite.
        """
        if done in MATERIAL_STEPS:
            self._search_materials(done)
        self._step(done)
        unknowns = {"light": self.light, "albedo": self.albedo, "roughness": self.roughness, "metallic": self.metallic}
        require_finite(unknowns, f"after step {done + 1} of the second stage")

    def copied(self) -> LightMaterialSolver:
        """Return a copy that goes its own way."""
        other = copy.copy(self)  # steps replace tensors, they do not change them
        other.generator = torch.Generator().set_state(self.generator.get_state())
        return other

    def subsampled(self, every: int) -> LightMaterialSolver:
        """Return a solver at its start for each `every`-th point; this one must be at its start, too."""
        kept = torch.arange(len(self.albedo), device=self.albedo.device) % every == 0
        samples, transfer = self.samples.subset(kept), self.transfer.subset(kept)
        return LightMaterialSolver(samples, transfer, self.roughness[kept], self.metallic[kept], self._seed, self._search_metal, self._seen)

    def start_dark(self) -> None:
        """Start from a dark albedo under a bright light instead."""
        self.albedo, self.start_albedo = torch.full_like(self.albedo, DARK_ALBEDO), DARK_ALBEDO
        self.light = self.light * (MEDIUM_ALBEDO / DARK_ALBEDO)

    def light_map(self, height: int) -> torch.Tensor:
        """Return the light as a lat-long map (height, 2 height, 3), linear radiance."""
        return self.transfer.texels.map(self.light, height)

    def split_texels(self, split: Split) -> None:
        """Continue with smaller texels where the light is bright."""
        self.transfer, old = split(self.transfer, self.light)
        self.light = self.light[torch.from_numpy(old).to(self.light.device)].contiguous()
        self._light_prior = LightPrior(self.transfer.texels, self.light.device, self._seen)
        self._diffuse = self.transfer.diffuse_rows(self.samples)
        self._search = self._search.with_transfer(self.transfer, self._diffuse)
        self._loosened = SPLIT_CAUCHY_FACTOR
        self._update_model()

    def grow_metal(self) -> None:
        """Redraw the borders of metal by searched normals and colours, too; at least one point is metal."""
        costs, weight = self._costs(), self.robust_weight * self.derivative**2
        metal = self._search.grown_metal(costs, self.metallic > 0, self.light, weight, self.surface_normal)
        self._set_materials(costs, metal, with_prior=True)

    def turn_metal(self) -> None:
        """Search the normals of metal by its reflections, with its roughness, and let the light follow; at least one point is metal."""
        metal = self.metallic > 0
        samples, transfer = self.samples.subset(metal), self.transfer.subset(metal)
        normal, self.roughness = self.samples.normal.clone(), self.roughness.clone()
        normal[metal], self.roughness[metal] = reflected_normals(samples, transfer, self.light, self.surface_normal[metal])
        self.samples = replace(self.samples, normal=normal)
        self._follow(TURN_STEPS)

    def settle(self) -> float:
        """Search the roughness with its prior, and let the light follow; return the root mean square of the roughness's change."""
        before = self.roughness
        self.set_roughness(self._search.likely_roughness(self._costs(), self.metallic > 0, self.albedo), SETTLING_STEPS, SETTLING_WEIGHT)
        return float((self.roughness - before).square().mean().sqrt())

    def set_roughness(self, roughness: torch.Tensor, steps: int, prior_weight: float | None = None) -> None:
        """Set the roughness (P,), that of metal apart, which was found together with its normals, and let the light follow in `steps`."""
        self.roughness = torch.where(self.metallic > 0, self.roughness, roughness)
        self._follow(steps, prior_weight)

    def reduce_tint(self) -> None:
        """Move a tint of the light into the albedo as far as the photographs leave it open; nothing shows it on an object of metal."""
        if self.is_all_metal:
            return
        likely = self._light_prior.likely_tint(self.light, self._curvature, self.error())
        change = (likely - self._light_prior.tint(self.light)).exp()
        self.light, self.albedo = self.light * change, (self.albedo / change).clamp(*ALBEDO_RANGE)

    def error(self) -> float:
        """Return the median difference between model and images, approximately in encoded values 0..1."""
        return float(((self._radiance(*self._model.terms(self.light)) - self.samples.colour) * self.derivative).abs().median())

    def total_error(self) -> float:
        """Return the robust error of all samples."""
        return float(self.point_errors().sum())

    def point_errors(self) -> torch.Tensor:
        """Return the robust error (P,) of each point."""
        return robust_error(self.samples, self._radiance(*self._model.terms(self.light)), self.derivative)

    def _follow(self, steps: int, prior_weight: float | None = None) -> None:
        """Let the light follow changed normals or materials; from now on, points of metal that fit badly count less for it."""
        self._update_model()
        self._trust = metal_trust(self.point_errors() / self.samples.lengths, self.metallic > 0)
        for _ in range(steps):
            self._step(STEPS, prior_weight)

    def _radiance(self, factor: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
        """Return the radiance (K, 3) that the samples should have, by the terms of the model."""
        return self.albedo[self.samples.point] * factor + rest

    def _update_model(self) -> None:
        """Compute the radiance's dependence on the light for the current materials, normals and texels."""
        self._model = SampleRadiance(self.samples, self.transfer, self._diffuse, self.roughness, self.metallic)
        self._hessian: list[torch.Tensor] | None = None
        self._age, self._last_error = 0, math.inf  # steps for which the Hessian has counted, and the error before the last of them

    def _step(self, done: int, prior_weight: float | None = None) -> None:
        """Solve the albedo, then do a Gauss-Newton step of the light with the albedo eliminated; see `albedo_prior` for the weight."""
        samples, y = self.samples, self.samples.colour
        factor, rest = self._model.terms(self.light)
        radiance = self._radiance(factor, rest)
        error, unexplained = (radiance - y) * self.derivative, float(robust_error(samples, radiance, self.derivative).sum())
        rises, self._last_error = unexplained > self._last_error, unexplained
        robust = 1 / (1 + (error / (self._loosened * CAUCHY_SCALE)) ** 2) if done >= CONSTANT_STEPS else torch.ones_like(error)
        self._loosened = max(1.0, self._loosened / 2)
        self.robust_weight = torch.where(samples.saturated & (error > 0), 0.0, robust)  # a clipped highlight is a lower bound
        weight = self.robust_weight * self.derivative**2
        anchor, pull = albedo_prior(self.albedo, done, self.start_albedo, self.generator, prior_weight)
        total = samples.sums(weight * factor * factor) + pull
        self.albedo = ((samples.sums(weight * factor * (y - rest)) + pull * anchor) / total).clamp(*ALBEDO_RANGE)
        weight = weight * self._trust[samples.point, None]
        if self._hessian is None or self._age >= MAX_HESSIAN_AGE or self._moved > MAX_HESSIAN_STEP or rises:
            self._hessian, self._age = self._model.hessian(self.albedo, weight, factor, samples.sums(weight * factor * factor) + pull), 0
        self._age += 1
        residual = self._radiance(factor, rest) - y
        self._step_light(self._hessian, self._model.gradient(self.albedo, weight * residual), (residual * self.derivative).abs().median())

    def _step_light(self, hessians: list[torch.Tensor], gradient: torch.Tensor, error: torch.Tensor) -> None:
        """Do a damped Gauss-Newton step of the light, by the Hessian (T, T) of each channel, the gradient (T, 3), and the median error."""
        log_light = self.light.log()
        step, self._curvature = damped_step(self.light, hessians, gradient, self._light_prior.terms(self.light, float(error)))
        self.light = self.transfer.texels.with_one_colour((log_light - step).clamp(*LOG_LIGHT_RANGE).exp())
        self._moved = float((self.light.log() - log_light).square().mean().sqrt())

    def _search_materials(self, done: int) -> None:
        """Search roughness and metallic; test the candidates for metal at METAL_TEST_STEP, draw its borders anew at METAL_BORDERS_STEP."""
        if done == METAL_TEST_STEP and bool(self.candidates.any()):
            self._test_metal()
            return
        costs, metal = self._costs(), self.candidates & (self.metallic > 0)
        if self._search_metal and done < METAL_TEST_STEP:
            metal = self.candidates = self.candidates | self._search.metal_candidates(costs)
        elif done == METAL_BORDERS_STEP:
            redrawn = self._search.redrawn_metal(costs, metal, self.light, self.robust_weight * self.derivative**2)
            metal = completed_metal(redrawn, self._adapted)
        # Sooner, the prior would settle on a roughness before the light does, see `roughness_prior`.
        self._set_materials(costs, metal, with_prior=done == MATERIAL_STEPS[-1])

    def _test_metal(self) -> None:
        """Keep those regions of candidates as metal that explain the photographs better so, and the light that has adapted to them."""
        without, whole = self._adapted(torch.zeros_like(self.candidates)), self._adapted(self.candidates)
        gain = without.errors - whole.errors
        found = self._search.regions(self._search.supported(self.candidates, gain))
        regions = measured_regions(found, self.samples, whole.solution.roughness, gain)
        best = confirm_metal(regions, without, self._adapted, LightMaterialSolver._metal_colours)
        self.metal_gain = 1 - float(best.errors.sum()) / max(float(without.errors.sum()), 1e-30)
        for name in ("light", "albedo", "robust_weight", "roughness", "metallic"):
            setattr(self, name, getattr(best.solution, name))
        self.regions = len(regions), sum(bool((region.points & best.metal).any()) for region in regions)
        self._update_model()

    def _adapted(self, metal: torch.Tensor) -> Hypothesis[LightMaterialSolver]:
        """Return a copy whose light has adapted to the metal points `metal` (P,) bool, and its robust error of each point (P,)."""
        trial = copy.copy(self)
        trial._set_materials(trial._costs(), metal)
        for _ in range(TEST_STEPS):
            trial._step(STEPS)
        return Hypothesis(metal, trial, trial.point_errors())

    def _metal_colours(self, metal: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Compare colours with those of the metal points `metal` (P,) bool, see `MaterialSearch.metal_colours`."""
        return self._search.metal_colours(self._costs(), metal, self.light, self.robust_weight * self.derivative**2)

    def _costs(self) -> torch.Tensor:
        """Return the costs of materials under the current light, see `MaterialSearch.costs`."""
        return self._search.costs(self.light, self.robust_weight * self.derivative**2, self.derivative)

    def _set_materials(self, costs: torch.Tensor, metal: torch.Tensor, with_prior: bool = False) -> None:
        """Set which points are metal (P,) bool, and the roughness of least cost, or the most likely one `with_prior`."""
        self.roughness = self._search.likely_roughness(costs, metal, self.albedo) if with_prior else self._search.roughness(costs, metal)
        self.metallic = metal.to(self.metallic)
        self._update_model()
