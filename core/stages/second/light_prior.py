# SPDX-License-Identifier: GPL-3.0-or-later
"""Prior of the light that the solver finds: smooth, except across the outlines of windows, lamps and the sky.

A quadratic penalty of differences spreads a lamp over its surroundings, so that shadows become soft and their edges are left in the
albedo. The robust penalty c^2 log(1 + (d / c)^2) of a difference d lets go of differences above c. It is minimised by
reweighting: in each step of the solver it is a quadratic form with the weights of the current light.
"""

from __future__ import annotations

import math

import torch

SMOOTHNESS = 1e-7  # weight of the log light's differences, per pair of neighbouring texels
SLOPE = 2.55  # change of the log light per radian at which the weight of a pair is halved; 0.5 between texels of a map of 16 rows


class LightPrior:
    """Smoothness of a lat-long map.

    Args:
        height: rows of the map.
        device: of its tensors.
    """

    def __init__(self, height: int, device: torch.device | str) -> None:
        self._texels, self._edge = 2 * height * height, SLOPE * math.pi / height
        index = torch.arange(self._texels, device=device).view(height, -1)
        across, down = (index, index.roll(-1, 1)), (index[:-1], index[1:])
        self._pairs = torch.cat([torch.stack(pair, -1).view(-1, 2) for pair in (across, down)])

    def form(self, light: torch.Tensor) -> torch.Tensor:
        """Return the quadratic form (T, T) of the log radiance of one channel.

        Args:
            light: (T, 3) current linear radiance, > 0. All channels share their edges.
        """
        log_light = light.log().mean(1)
        difference = log_light[self._pairs[:, 0]] - log_light[self._pairs[:, 1]]
        return SMOOTHNESS * self.laplacian(1 / (1 + (difference / self._edge) ** 2))

    def laplacian(self, weight: torch.Tensor) -> torch.Tensor:
        """Return the quadratic form (T, T) of the sum of the squared differences of neighbours, weighted by `weight`, one of each pair."""
        form = weight.new_zeros(self._texels, self._texels)
        form.view(-1).index_add_(0, self._pairs[:, 0] * self._texels + self._pairs[:, 1], weight)
        off = form + form.T
        return torch.diag(off.sum(1)) - off
