# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels between the sums over samples and the image: the estimate of the reflected light, and what the denoiser filters of it.

Called by core/relight/estimate.py and core/relight/denoise.py, which define both in PyTorch operations.
"""

from __future__ import annotations

import numpy as np

from .jit import kernel

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@kernel
def estimate_range(begin, end, sums, known, body, f0, by_ratio, most, out):
    """Write, for points begin..end, the diffuse and the specular light, and the differences of their halves, to `out` (4, P, 3).

    sums: (P, 2, 12) or more; known: (P, 3) unoccluded irradiance, read where `by_ratio` is True; most: largest factor of correction.
    """
    least = _ONE / most
    for p in range(begin, end):
        for c in range(3):
            even, odd = sums[p, 0, c], sums[p, 1, c]
            irradiance, split, albedo = even + odd, even - odd, body[p, c]
            if by_ratio:
                even, odd = sums[p, 0, 9 + c], sums[p, 1, 9 + c]
                unoccluded = even + odd
                if unoccluded > _ZERO:
                    albedo *= min(max(known[p, c] / unoccluded, least), most)
                    split -= irradiance / unoccluded * (even - odd)
            out[0, p, c], out[2, p, c] = albedo * irradiance, albedo * split
            even = f0[p, c] * sums[p, 0, 3 + c] + sums[p, 0, 6 + c]
            odd = f0[p, c] * sums[p, 1, 3 + c] + sums[p, 1, 6 + c]
            out[1, p, c], out[3, p, c] = even + odd, even - odd


@kernel
def demodulate_range(begin, end, light, split, albedo, places, plane, planes):
    """Write light over albedo, (P, 3) each, and the mean square of `split` over albedo to the four planes, at `places` (P,)."""
    for p in range(begin, end):
        at, square = places[p], _ZERO
        for c in range(3):
            inverse = _ONE / albedo[p, c]
            planes[c * plane + at] = light[p, c] * inverse
            noise = split[p, c] * inverse
            square += noise * noise
        planes[3 * plane + at] = square * np.float32(1 / 3)


@kernel
def remodulate_range(begin, end, planes, albedo, places, plane, light):
    """Write to `light` (P, 3) the values of three planes at `places` (P,), times the albedo (P, 3)."""
    for p in range(begin, end):
        for c in range(3):
            light[p, c] = planes[c * plane + places[p]] * albedo[p, c]
