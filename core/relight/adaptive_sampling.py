# SPDX-License-Identifier: GPL-3.0-or-later
"""How many samples each tile of an image needs, so that the image errs by no more than asked: found from what few samples tell.

The error is that of the sRGB image in 0..1, root mean square over the object's pixels and channels, against the converged one. Its
variance follows from the halves of the samples; what of it the denoiser takes away is V - D, with V the variance and D the mean square
of what the filter changed (both means over a tile: for the filter's weight k = B / (B + V), see `corrected`, D is V^2 / (B + V)).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from .primary_hits import PrimaryHits

TILE = 8  # pixels
PILOT = 16  # samples that every tile gets
STEPS = tuple(PILOT << i for i in range(9))  # what it may get, up to 4096
ROUNDS = 3  # of finding out
RATE = 1.2  # power of the number by which the variance falls: sets of low discrepancy, but edges of shadows
HALVES = 0.62  # the variance over the square of half the difference of both halves: each is a worse set of points than both together
CAUTION = 1.0  # the same where filtered: what few samples have missed no filter restores
MIXED = 0.03  # of the variance is left where the filter alone is believed


@dataclass(frozen=True, eq=False)
class Noise:
    """Attributes: variance, bias2: (T,) of tiles, the first undenoised, the second what the filter would err by; samples: (T,) so far;
    pixels: (T,) in each tile; tile: (P,) of each pixel.
    """

    variance: torch.Tensor
    bias2: torch.Tensor
    samples: torch.Tensor
    pixels: torch.Tensor
    tile: torch.Tensor

    def error2(self, samples: torch.Tensor) -> torch.Tensor:
        """Expected squared error of tiles were `samples` (.., T) taken."""
        variance = self.variance * (self.samples / samples) ** RATE
        kept = self.bias2 / (self.bias2 + variance).clamp_min(1e-30)
        return variance * torch.where(self.bias2.isinf(), 1.0, kept + (1 - kept) * MIXED)

    def error(self) -> float:
        """Of the image."""
        return float(((self.error2(self.samples) * self.pixels).sum() / self.pixels.sum()).sqrt())

    def needed(self, error: float) -> torch.Tensor:
        """(T,) samples, of STEPS and no fewer than there are, fewest in all so that the image errs by no more than `error`."""
        steps = self.samples.new_tensor(STEPS)[:, None].maximum(self.samples)
        errors, room = self.error2(steps), error**2 * self.pixels.sum()
        low, high = -30.0, 5.0  # of the logarithm of what a sample is worth
        for _ in range(40):
            middle = (low + high) / 2
            best = (errors + 10.0**middle * steps).argmin(0)
            good = (errors.gather(0, best[None])[0] * self.pixels).sum() <= room
            low, high = (middle, high) if good else (low, middle)
        return steps.gather(0, (errors + 10.0**low * steps).argmin(0)[None])[0].round().long()


def noise(
    raw: torch.Tensor, split: torch.Tensor, colour: torch.Tensor, samples: torch.Tensor, surface: PrimaryHits, filtered: bool
) -> Noise:
    """From P points' light as estimated and how its halves differ (`Estimate`), as it is shown, all (P, 3), and samples (P,)."""
    slope = encoding_slope(colour) * surface.alpha[:, None]
    variance = (CAUTION if filtered else HALVES) * (split * slope).square().mean(1)
    change = ((raw - colour) * slope).square().mean(1)
    tile, pixels = tiles(surface)
    sums = variance.new_zeros(3, len(pixels)).index_add_(1, tile, torch.stack([variance, change, samples.float()])) / pixels
    variance, change, samples = sums
    bias2 = (variance**2 / change.clamp_min(1e-30) - variance).clamp_min(0) if filtered else torch.full_like(variance, torch.inf)
    return Noise(variance, bias2, samples, pixels, tile)


def tiles(surface: PrimaryHits) -> tuple[torch.Tensor, torch.Tensor]:
    """(P,) which tile each point lies in, of those that hold any, and (T,) how many they hold."""
    width = surface.camera.width
    place = surface.index // width // TILE * width + surface.index % width // TILE
    _, tile, pixels = place.unique(return_inverse=True, return_counts=True)
    return tile, pixels.float()


def encoding_slope(colour: torch.Tensor) -> torch.Tensor:
    """How steep sRGB's encoding is at linear values; 0 above 1, where it is clipped."""
    slope = torch.where(colour > 0.0031308, 1.055 / 2.4 * colour.clamp_min(0.0031308) ** (1 / 2.4 - 1), 12.92)
    return torch.where(colour < 1, slope, 0.0)
