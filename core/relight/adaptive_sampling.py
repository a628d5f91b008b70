# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive sampling: the number of samples per tile with which the image reaches a requested error.

The error is the root mean square of the sRGB image in 0..1 over the object's pixels and channels, against the converged image. Its
variance is estimated from the two halves of the samples. The denoiser removes V - D of it, with V the variance and D the mean square of
what the filter changed, both as means over a tile: for the filter's weight k = B / (B + V), B the squared bias of the filter (see
`corrected` in `denoise.py`), D is V^2 / (B + V).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from .primary_hits import PrimaryHits

TILE = 8  # pixels along a side
PILOT = 16  # samples of every pixel in the first round
STEPS = tuple(PILOT << i for i in range(9))  # allowed numbers of samples, up to 4096
ROUNDS = 3  # of estimating the noise and adding samples
RATE = 1.2  # the variance falls with samples^-RATE: faster than 1 by low discrepancy, slower than 2 at shadow edges
HALVES = 0.62  # variance over the squared half difference of the two halves: each half has a higher discrepancy than the whole set
CAUTION = 1.0  # the same where the image is filtered: a filter cannot restore light that few samples have missed
MIXED = 0.03  # fraction of the variance that remains in a fully filtered tile


@dataclass(frozen=True, eq=False)
class Noise:
    """Estimated noise of an image of T tiles.

    Attributes:
        variance: (T,) variance before denoising, of sRGB values.
        bias2: (T,) squared bias of the denoiser; infinite without one.
        samples: (T,) samples per pixel taken so far.
        pixels: (T,) number of the object's pixels in each tile.
        tile: (P,) tile of each pixel.
    """

    variance: torch.Tensor
    bias2: torch.Tensor
    samples: torch.Tensor
    pixels: torch.Tensor
    tile: torch.Tensor

    def error2(self, samples: torch.Tensor) -> torch.Tensor:
        """Predict the squared error (..., T) of the tiles for given numbers of samples (..., T)."""
        variance = self.variance * (self.samples / samples) ** RATE
        weight = self.bias2 / (self.bias2 + variance).clamp_min(1e-30)
        return variance * torch.where(self.bias2.isinf(), 1.0, weight + (1 - weight) * MIXED)

    def error(self) -> float:
        """Return the root-mean-square error of the image."""
        return float(((self.error2(self.samples) * self.pixels).sum() / self.pixels.sum()).sqrt())

    def needed(self, error: float) -> torch.Tensor:
        """Return the numbers of samples (T,) of least sum with which the image's error is at most `error`.

        Each is one of STEPS or the present number, and none is below the present one.
        """
        steps = self.samples.new_tensor(STEPS)[:, None].maximum(self.samples)
        errors, budget = self.error2(steps), error**2 * self.pixels.sum()
        low, high = -30.0, 5.0  # decimal logarithm of the Lagrange multiplier, the price of a sample, found by bisection
        for _ in range(40):
            middle = (low + high) / 2
            best = (errors + 10.0**middle * steps).argmin(0)
            sufficient = (errors.gather(0, best[None])[0] * self.pixels).sum() <= budget
            low, high = (middle, high) if sufficient else (low, middle)
        return steps.gather(0, (errors + 10.0**low * steps).argmin(0)[None])[0].round().long()


def estimate_noise(
    raw: torch.Tensor, split: torch.Tensor, colour: torch.Tensor, samples: torch.Tensor, surface: PrimaryHits, filtered: bool
) -> Noise:
    """Estimate the noise of an image of P surface points.

    Args:
        raw: (P, 3) linear radiance before denoising.
        split: (P, 3) difference of its two halves of samples, see `Estimate`.
        colour: (P, 3) linear radiance after denoising.
        samples: (P,) samples per point.
        surface: the points.
        filtered: True where a denoiser was applied.
    """
    slope = srgb_derivative(colour) * surface.alpha[:, None]
    variance = (CAUTION if filtered else HALVES) * (split * slope).square().mean(1)
    change = ((raw - colour) * slope).square().mean(1)
    tile, pixels = tiles(surface)
    sums = variance.new_zeros(3, len(pixels)).index_add_(1, tile, torch.stack([variance, change, samples.float()])) / pixels
    variance, change, samples = sums
    bias2 = (variance**2 / change.clamp_min(1e-30) - variance).clamp_min(0) if filtered else torch.full_like(variance, torch.inf)
    return Noise(variance, bias2, samples, pixels, tile)


def tiles(surface: PrimaryHits) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the tile of each point, (P,), numbered over the tiles that hold points, and the number of points in each tile, (T,)."""
    width = surface.camera.width
    position = surface.index // width // TILE * width + surface.index % width // TILE
    _, tile, pixels = position.unique(return_inverse=True, return_counts=True)
    return tile, pixels.float()


def srgb_derivative(colour: torch.Tensor) -> torch.Tensor:
    """Return the derivative of the sRGB curve at linear values (...,); 0 above 1, where the image is clipped."""
    slope = torch.where(colour > 0.0031308, 1.055 / 2.4 * colour.clamp_min(0.0031308) ** (1 / 2.4 - 1), 12.92)
    return torch.where(colour < 1, slope, 0.0)
