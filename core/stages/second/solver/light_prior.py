# SPDX-License-Identifier: GPL-3.0-or-later
"""Prior of the light that the solver finds: smooth, except across the outlines of windows, lamps and the sky, and about neutral.

A quadratic penalty of differences spreads a lamp over its surroundings, so that shadows become soft and their edges are left in the
albedo. The robust penalty c^2 log(1 + (d / c)^2) of a difference d lets go of differences above c. It is minimised by
reweighting: in each step of the solver it is a quadratic form with the weights of the current light.

Where the photographs show the light itself, beside the object, its logarithm is also pulled towards what they show (`seen_light`).

A tint of the light and the opposite tint of the albedo look alike but for the highlights, which have the light's own colour. Cameras
balance white, so that the mean light is about neutral where highlights do not tell.
"""

from __future__ import annotations

import torch

from .light_texels import LightTexels
from .seen_light import SeenLight

SMOOTHNESS = 1e-7  # weight of the log light's differences, per pair of neighbouring texels
SEEN_WEIGHT = 3e-6  # weight of the squared difference of the log light of one of the largest texels from what all photographs show alike
MAX_LIKELY_TINT = 0.2  # log tint of the mean light above which it is unlikely; 0.02 to 0.16 in seven of eight lights of test scenes
NEWTON_STEPS = 60  # each takes at most a third off a tint that is much too large
INDEPENDENT_ERRORS = 50  # number of independent errors of the photographs, whose neighbours and views err alike
# Change of the log light per radian at which the weight of a pair is halved; 0.67 between texels of a map of 12 rows.
HALF_WEIGHT_SLOPE = 2.55
# Error of the photographs, encoded, from which small texels are as smooth as those of 12 rows; below, less with its square. Without this
# a lamp collapsed to one bright texel where photographs are noisy (errors of .009 and .011): a captured car's light has 18.6 dB with it and
# 10.5 without, a chair's 13.8 and 8.1. Lights of three objects with errors of .004 to .005 would have 1 to 2 dB less with equal smoothness.
ROUGH_EDGE, ROUGH_ERROR = 0.67, 0.01


class LightPrior:
    """Smoothness of the light in its texels, and its agreement with what photographs show of it.

    Args:
        texels: texels of the light.
        device: device of its tensors.
        seen: light that the photographs show; None for none.
    """

    def __init__(self, texels: LightTexels, device: torch.device | str, seen: SeenLight | None = None) -> None:
        pairs, weight, distance = (torch.from_numpy(part).to(device) for part in texels.pairs)
        self._texels, self._pairs, self._weight, self._edge = texels.count, pairs, weight.float(), HALF_WEIGHT_SLOPE * distance.float()
        self._solid_angles = torch.from_numpy(texels.solid_angles).float().to(device)
        shown = (torch.zeros(texels.count), torch.zeros(texels.count, 3)) if seen is None else seen.of_texels(texels)
        self._pull, self._shown = SEEN_WEIGHT * shown[0].to(device), shown[1].to(device)

    def terms(self, light: torch.Tensor, error: float) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the quadratic form (T, T) of the log radiance of each channel, and the gradient (T, 3).

        Args:
            light: (T, 3) current linear radiance, > 0. All channels share their edges.
            error: median error of the photographs, encoded.
        """
        form, log_light = self.form(light, error), light.log()
        return form + torch.diag(self._pull), form @ log_light + self._pull[:, None] * (log_light - self._shown)

    def form(self, light: torch.Tensor, error: float) -> torch.Tensor:
        """Return the quadratic form (T, T) of the smoothness of the log radiance of one channel; see `terms`."""
        log_light = light.log().mean(1)
        difference = log_light[self._pairs[:, 0]] - log_light[self._pairs[:, 1]]
        edge = self._edge.clamp_min(ROUGH_EDGE * min(1.0, (error / ROUGH_ERROR) ** 2))
        return SMOOTHNESS * self.laplacian(self._weight / (1 + (difference / edge) ** 2))

    def laplacian(self, weight: torch.Tensor) -> torch.Tensor:
        """Return the quadratic form (T, T) of the sum of the squared differences of neighbours, weighted by `weight`, one of each pair."""
        form = weight.new_zeros(self._texels, self._texels)
        form.view(-1).index_add_(0, self._pairs[:, 0] * self._texels + self._pairs[:, 1], weight)
        off = form + form.T
        return torch.diag(off.sum(1)) - off

    def tint(self, light: torch.Tensor) -> torch.Tensor:
        """Return the log tint (3,) of the mean of a light (T, 3) over the sphere; its sum is 0."""
        mean = (light * self._solid_angles[:, None].to(light)).sum(0).log()
        return mean - mean.mean()

    def likely_tint(self, light: torch.Tensor, curvature: torch.Tensor, error: float) -> torch.Tensor:
        """Return the most likely log tint (3,) of a light, between that which fits the photographs best and none.

        The prior's negative logarithm is (t / MAX_LIKELY_TINT)^4 / 4: small tints are all alike likely, large ones hardly.

        Args:
            light: (T, 3) linear radiance that fits the photographs best.
            curvature: (3,) of half their mean squared error in each channel's log brightness.
            error: median of their absolute errors.
        """
        fitted = tint = self.tint(light)
        variance = (error / 0.6745) ** 2 / INDEPENDENT_ERRORS  # of the mean; 0.6745: the median of a normal distribution's absolute values
        cubic = variance / (curvature.clamp_min(1e-30) * MAX_LIKELY_TINT**4)
        for _ in range(NEWTON_STEPS):
            tint = tint - (tint + cubic * tint**3 - fitted) / (1 + 3 * cubic * tint**2)
        return tint - tint.mean()
