# SPDX-License-Identifier: GPL-3.0-or-later
"""Density control: clone, split and prune Gaussians by screen-space gradients (3DGS, Kerbl et al. 2023) within a budget."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch

from ...errors import IrgsppError
from ...kernels.rasterize import MIN_GAUSSIANS, ScreenStatistics
from ...scene.gaussians import Gaussians
from ..common.optimizer import GaussianOptimizer

PRUNE_OPACITY = 0.05  # Gaussians below are removed
RESET_OPACITY = 0.1  # a reset clamps opacities to this
MIN_HULL_FRACTION = 0.4  # least fraction of the initial surfels that must remain; consistent images prune a few per cent
SPLIT_SHRINK = 1.6  # scales of a split Gaussian are divided by this


@dataclass
class DensityControl:
    """Density control with the screen-space gradient statistics that it decides by.

    Attributes:
        budget: largest number of Gaussians.
        radius: scene radius, world units.
        large: scale over the scene radius above which a Gaussian is split, below which it is cloned.
        huge: scale over the scene radius above which a Gaussian is removed.
        grow: fraction of the Gaussians that are cloned or split at a time.
        images: number of images since the last change.
        gradient: (N,) sum over images of the screen-space gradient's norm.
        seen: (N,) number of images with a gradient.
    """

    budget: int
    radius: float
    large: float = 0.01
    huge: float = 0.5
    grow: float = 0.1
    images: int = 0
    gradient: torch.Tensor = field(default_factory=lambda: torch.zeros(0))
    seen: torch.Tensor = field(default_factory=lambda: torch.zeros(0))

    def accumulate(self, statistics: ScreenStatistics) -> None:
        """Add the gradients of one image; call it after the backward pass."""
        if len(self.gradient) != len(statistics.radius):
            self.gradient, self.seen = torch.zeros_like(statistics.radius, dtype=torch.float32).repeat(2, 1)
        self.images += 1
        assert statistics.gradient is not None, "accumulate after the backward pass"
        self.gradient += statistics.gradient
        self.seen += statistics.gradient > 0  # Gaussians behind opaque surfaces have no gradient

    def refine(self, optimizer: GaussianOptimizer, generator: torch.Generator, grow: bool) -> tuple[int, int]:
        """Prune Gaussians that are transparent, huge, or without gradient since the last call; optionally clone and split others.

        Args:
            optimizer: holds the Gaussians, which are replaced.
            generator: random generator of the positions of split Gaussians.
            grow: clone and split the Gaussians with the largest mean gradient, as far as the budget allows.

        Returns:
            The numbers of added and of pruned Gaussians.

        Raises:
            IrgsppError: fewer than MIN_GAUSSIANS would be left.
        """
        g = optimizer.gaussians
        with torch.no_grad():
            width = g.log_scale.exp().amax(0)
            keep = (g.opacity.sigmoid() > PRUNE_OPACITY) & (width < self.huge * self.radius)
            if len(self.seen) == g.count:
                keep &= self.seen > 0
            if int(keep.sum()) < MIN_GAUSSIANS:
                raise IrgsppError("first stage: no Gaussian is left that is opaque and visible; check that cameras and masks match")
            mean_gradient = torch.where(keep, self._mean_gradient(g.count), 0.0)
            spare = max(0, self.budget - int(keep.sum()))
            count = min(spare, math.ceil(self.grow * int(keep.sum())), int((mean_gradient > 0).sum())) if grow else 0
            chosen = mean_gradient.topk(count).indices.sort().values
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

    def _mean_gradient(self, count: int) -> torch.Tensor:
        """Return the (N,) mean gradient over the images that see a Gaussian; zeros where the statistics are of another set."""
        if len(self.gradient) != count:
            return self.gradient.new_zeros(count)
        return self.gradient / self.seen.clamp_min(1)

    def _half(self, g: Gaussians, index: torch.Tensor, generator: torch.Generator) -> Gaussians:
        """Return a smaller copy of each Gaussian, displaced within its plane by a draw from its own distribution."""
        half = g.select(index)
        tu, tv = half.tangents()
        offset = torch.randn(2, half.count, generator=generator).to(half.log_scale) * half.log_scale.exp()
        half.position += tu * offset[0] + tv * offset[1]
        half.log_scale -= math.log(SPLIT_SHRINK)
        return half


def reset_opacity(optimizer: GaussianOptimizer) -> None:
    """Clamp all opacities to RESET_OPACITY (3DGS): those of needed Gaussians recover, those of floaters do not."""
    limit = math.log(RESET_OPACITY / (1 - RESET_OPACITY))
    with torch.no_grad():
        optimizer.leaves["opacity"].clamp_(max=limit)
    optimizer.reset_moments("opacity")


def require_surfels(left: int, initial: int, done: int) -> None:
    """Raise IrgsppError where most of the initial surfels were pruned: with masks, none grow back.

    Args:
        left: surfels that are left.
        initial: surfels that the fit started with.
        done: steps done.
    """
    if left < MIN_HULL_FRACTION * initial:
        lost = f"only {left:,} of {initial:,} surfels that the fit started with are left at iteration {done}"
        raise IrgsppError(f"first stage: {lost}; check that cameras and masks match the images")
