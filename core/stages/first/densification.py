# SPDX-License-Identifier: GPL-3.0-or-later
"""Density control: clone, split and prune Gaussians by what the images ask for (3DGS's policy under a budget)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch

from ...errors import IrgsppError
from ...kernels.rasterize import MIN_GAUSSIANS, ScreenStatistics
from ...scene.gaussians import Gaussians
from ..common.optimizer import GaussianOptimizer

PRUNE_OPACITY = 0.05
RESET_OPACITY = 0.1
SPLIT_SHRINK = 1.6


@dataclass
class DensityControl:
    """Keeps the statistics of the screen-space gradient and changes the set of Gaussians.

    Attributes:
        budget: most Gaussians there may be.
        radius: scene radius; a Gaussian wider than `large` of it is split, a smaller one cloned, one wider than `huge` dropped.
    """

    budget: int
    radius: float
    large: float = 0.01
    huge: float = 0.5
    grow: float = 0.1  # share of the Gaussians that are cloned or split at a time
    images: int = 0  # looked at since the last change
    gradient: torch.Tensor = field(default_factory=lambda: torch.zeros(0))
    seen: torch.Tensor = field(default_factory=lambda: torch.zeros(0))

    def observe(self, statistics: ScreenStatistics) -> None:
        """Add one image's gradients."""
        if len(self.gradient) != len(statistics.radius):
            self.gradient, self.seen = torch.zeros_like(statistics.radius, dtype=torch.float32).repeat(2, 1)
        self.images += 1
        assert statistics.gradient is not None, "observe after the backward pass"
        self.gradient += statistics.gradient
        self.seen += statistics.gradient > 0  # what lies behind opaque surfaces has none

    def refine(self, optimizer: GaussianOptimizer, generator: torch.Generator, grow: bool) -> tuple[int, int]:
        """Prune what is transparent, huge, or was seen by no view since the last time; `grow`: clone and split what is pulled hardest.

        Returns (added, pruned). Raises IrgsppError where nothing would be left.
        """
        g = optimizer.gaussians
        with torch.no_grad():
            width = g.log_scale.exp().amax(0)
            keep = (g.opacity.sigmoid() > PRUNE_OPACITY) & (width < self.huge * self.radius)
            if len(self.seen) == g.count:
                keep &= self.seen > 0
            if int(keep.sum()) < MIN_GAUSSIANS:
                raise IrgsppError("density control: no Gaussian is left that is opaque and seen; do cameras and masks fit the photographs?")
            pull = torch.where(keep, self._pull(g.count), 0.0)
            room = max(0, self.budget - int(keep.sum()))
            count = min(room, math.ceil(self.grow * int(keep.sum())), int((pull > 0).sum())) if grow else 0
            chosen = pull.topk(count).indices.sort().values
            split = chosen[width[chosen] > self.large * self.radius]
            clone = chosen[width[chosen] <= self.large * self.radius]
            stay = torch.nonzero(keep)[:, 0]
            stay = stay[~torch.isin(stay, split)]
            halves = [self._half(g, split, generator) for _ in range(2)] if len(split) else []
            grown = g.select(stay).joined(g.select(clone))
            for half in halves:
                grown = grown.joined(half)
            fresh = stay.new_full((len(clone) + 2 * len(split),), -1)
            optimizer.rebuild(grown, torch.cat([stay, fresh]))
        pruned = g.count - int(keep.sum())
        self.images, self.gradient, self.seen = 0, torch.zeros(0), torch.zeros(0)
        return len(chosen), pruned

    def _pull(self, count: int) -> torch.Tensor:
        if len(self.gradient) != count:
            return self.gradient.new_zeros(count)
        return self.gradient / self.seen.clamp_min(1)

    def _half(self, g: Gaussians, index: torch.Tensor, generator: torch.Generator) -> Gaussians:
        """A smaller copy of each Gaussian, drawn from its own distribution in its plane."""
        half = g.select(index)
        tu, tv = half.tangents()
        offset = torch.randn(2, half.count, generator=generator).to(half.log_scale) * half.log_scale.exp()
        half.position += tu * offset[0] + tv * offset[1]
        half.log_scale -= math.log(SPLIT_SHRINK)
        return half


def reset_opacity(optimizer: GaussianOptimizer) -> None:
    """Lower every opacity to at most RESET_OPACITY: what is needed comes back, floaters don't."""
    limit = math.log(RESET_OPACITY / (1 - RESET_OPACITY))
    with torch.no_grad():
        optimizer.leaves["opacity"].clamp_(max=limit)
    optimizer.reset_moments("opacity")
