# SPDX-License-Identifier: GPL-3.0-or-later
"""Combination of a texel's candidates: a robust mean in which the best photographs count most, so that misalignment does not blur."""

from __future__ import annotations

import numpy as np

from ..kernels.cpu.jit import kernel
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .candidates import Candidates
from .texel_sampling import CODES

WEIGHT_POWER = 2.0  # of the weights: 1 is a mean over all candidates, large powers take the best alone
OUTLIER_DIFFERENCE = 0.12  # difference of log albedo from the robust centre at which a candidate counts half
ALBEDO_FLOOR = 0.02  # albedo added inside the logarithm, since the noise of dark texels is not relative
ROUNDS = 4  # of iteratively reweighted means


def combine(candidates: Candidates, power: float = WEIGHT_POWER, outlier: float = OUTLIER_DIFFERENCE) -> np.ndarray:
    """Combine candidates to albedo (P, 3) float32, 0 where there are none.

    The centre is the mean by plain weights, made robust by a Cauchy function of the distance from the last centre. The result is the mean
    by powers of the weights over the candidates that agree with the centre.

    Args:
        candidates: candidates of P texels.
        power: exponent of the weights in the result.
        outlier: difference of log albedo at which a candidate counts half.
    """
    albedo = np.zeros((len(candidates.weight), 3), np.float32)
    ranges = even_ranges(len(albedo), 8 * thread_count())
    run_ranges(combine_texels, ranges, candidates.colour, candidates.weight, power, outlier, albedo)
    return albedo


@kernel
def combine_texels(begin, end, colour, weight, power, outlier, albedo):
    """Write the combined albedo of the texels begin..end."""
    kept = weight.shape[1]
    trust, logs = np.zeros(kept), np.zeros((kept, 3))
    for p in range(begin, end):
        best = np.float32(0.0)
        for n in range(kept):
            best = max(best, weight[p, n])
        if best <= 0:
            continue
        for n in range(kept):
            trust[n] = 1.0
            for c in range(3):
                logs[n, c] = np.log(colour[p, n, c] / CODES + ALBEDO_FLOOR)
        for _ in range(ROUNDS):
            total, red, green, blue = 0.0, 0.0, 0.0, 0.0
            for n in range(kept):
                w = weight[p, n] / best * trust[n]
                total += w
                red += w * logs[n, 0]
                green += w * logs[n, 1]
                blue += w * logs[n, 2]
            for n in range(kept):
                away = (logs[n, 0] - red / total) ** 2 + (logs[n, 1] - green / total) ** 2 + (logs[n, 2] - blue / total) ** 2
                trust[n] = 1 / (1 + away / (3 * outlier * outlier))
        total = 0.0
        for c in range(3):
            albedo[p, c] = 0
        for n in range(kept):
            w = (weight[p, n] / best) ** power * trust[n]
            total += w
            for c in range(3):
                albedo[p, c] += w * colour[p, n, c] / CODES
        for c in range(3):
            albedo[p, c] /= total
