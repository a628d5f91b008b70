# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of a relit image: its estimated error, and the number of samples per pixel with which it falls to a requested one.

The error is the root mean square of the sRGB image in 0..1 over the object's pixels and channels, against the converged image. The two
halves of the samples tell the variance V of a pixel x. Where the denoiser changes x to f, Stein's unbiased risk estimate (1981) is
E (f - mean)^2 = D - V + 2 V df/dx with D = E (x - f)^2, all as means over a tile. The denoiser keeps k = B / (B + V) of x, B its squared
bias (see `corrected_reference` in `denoise.py`), so that D = V^2 / (B + V) tells B, and a fraction MIXED_FRACTION / 2 of the rest is x
itself. Then df/dx is k + (1 - k) MIXED_FRACTION / 2, and the risk V (k + (1 - k) MIXED_FRACTION), to which comes what D exceeds V by.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..io.srgb import encode_srgb
from .estimate import Estimate
from .primary_hits import PrimaryHits

TILE_SIDE = 8  # pixels along a side
PILOT_SAMPLES = 16  # samples of every pixel in the first round
SAMPLE_STEPS = tuple(PILOT_SAMPLES << i for i in range(9))  # allowed numbers of samples, up to 4096
MAX_ROUNDS = 3  # of rendering, with more samples in each
VARIANCE_RATE = 1.2  # the variance falls with samples^-VARIANCE_RATE: faster than 1 by low discrepancy, slower than 2 at shadow edges
# Variance over the squared half difference of the two halves of the samples: each half has a higher discrepancy than the whole set.
HALF_VARIANCE_RATIO = 0.62
MIXED_FRACTION = 0.1  # fraction of the variance that remains in a fully filtered tile: twice the filter's own weight of a pixel


@dataclass(frozen=True, eq=False)
class Noise:
    """Estimated noise of an image of T tiles.

    Attributes:
        variance: (T,) variance before denoising, of sRGB values.
        bias2: (T,) squared bias B of the denoiser; infinite without one.
        excess: (T,) squared change by the denoiser beyond the variance: it spread single bright samples, or filled what samples missed.
        pixels: (T,) number of the object's pixels in each tile.
        samples: samples per pixel.
    """

    variance: torch.Tensor
    bias2: torch.Tensor
    excess: torch.Tensor
    pixels: torch.Tensor
    samples: int

    def error(self, samples: int | None = None) -> float:
        """Return the root-mean-square error of the image, as it is or predicted for another number of samples."""
        fall = (self.samples / (samples or self.samples)) ** VARIANCE_RATE
        variance = self.variance * fall
        weight = torch.where(self.bias2.isinf(), 1.0, self.bias2 / (self.bias2 + variance).clamp_min(1e-30))
        error2 = variance * (weight + (1 - weight) * MIXED_FRACTION) + self.excess * fall
        return float(((error2 * self.pixels).sum() / self.pixels.sum()).sqrt())

    def needed(self, error: float) -> int:
        """Return the least of SAMPLE_STEPS above the present number of samples with which the error is at most `error`, or the largest."""
        more = [count for count in SAMPLE_STEPS if count > self.samples]
        return next((count for count in more if self.error(count) <= error), SAMPLE_STEPS[-1])


def estimate_noise(estimate: Estimate, colour: torch.Tensor, surface: PrimaryHits, filtered: bool) -> Noise:
    """Estimate the noise of an image of P surface points.

    Args:
        estimate: reflected light before denoising.
        colour: (P, 3) linear radiance after denoising.
        surface: the points.
        filtered: True where a denoiser was applied.
    """
    raw, split = estimate.diffuse + estimate.specular, estimate.diffuse_split + estimate.specular_split
    first, second, seen, shown = (_encoded(c, surface) for c in (raw + split, raw - split, raw, colour))  # of each half of the samples
    variance = HALF_VARIANCE_RATIO * ((first - second) / 2).square().mean(1)
    tile, pixels = tiles(surface)
    change = (seen - shown).square().mean(1)
    variance, change = variance.new_zeros(2, len(pixels)).index_add_(1, tile, torch.stack([variance, change])) / pixels
    bias2 = (variance**2 / change.clamp_min(1e-30) - variance).clamp_min(0) if filtered else torch.full_like(variance, torch.inf)
    return Noise(variance, bias2, (change - variance).clamp_min(0), pixels, estimate.samples)


def _encoded(colour: torch.Tensor, surface: PrimaryHits) -> torch.Tensor:
    """Return linear colours (P, 3) as they show in the image."""
    return encode_srgb(colour.clamp(0, 1)) * surface.alpha[:, None]


def tiles(surface: PrimaryHits) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the tile of each point, (P,), numbered over the tiles that hold points, and the number of points in each tile, (T,)."""
    width = surface.camera.width
    position = surface.index // width // TILE_SIDE * width + surface.index % width // TILE_SIDE
    _, tile, pixels = position.unique(return_inverse=True, return_counts=True)
    return tile, pixels.float()
