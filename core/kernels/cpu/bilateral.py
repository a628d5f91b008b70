# SPDX-License-Identifier: GPL-3.0-or-later
"""Cross-bilateral filter: mean over neighbouring pixels on the same surface, 8 pixels of a row to a vector.

Called by core/relight/denoise.py. Weight of neighbour p' at p:
exp(-|p - p'|^2 / 2 sigma^2) max(n.n', 0)^(2^k) exp(-|z - z'| / (|grad z . (p - p')| + epsilon)) times its coverage.
Guides: normal 3, depth, its slopes per pixel to the right and down, coverage (0 = empty).
Images are flattened channel planes with a margin of empty pixels on every side, so that no load runs out of bounds; a group is 8
pixels of a row, identified by the index of its first pixel.
"""

from __future__ import annotations

import numpy as np

from .jit import helper, kernel
from .simd import bits, load, load_uint16, maximum, minimum, splat, store, store_uint16
from .simd_math import exp

WHOLE, HALF = np.float32(65000), np.float32(0.5)  # weights are kept as uint16 in units of 1 / WHOLE: half the memory to read of float32


@helper
def _absolute(x):
    """Return |x| of a vector."""
    return maximum(x, x * -1.0)


@helper
def _weigh(at, guides, spatial, epsilon, doublings, stride, plane, weights, to):
    """Write the weights of the group `at` in units of 1 / WHOLE, a vector for each neighbour, to weights[to..]."""
    reach = spatial.shape[0] // 2
    nx, ny, nz = load(guides, at), load(guides, plane + at), load(guides, 2 * plane + at)
    z, right, down = load(guides, 3 * plane + at), load(guides, 4 * plane + at), load(guides, 5 * plane + at)
    tap = to
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            neighbour = at + dy * stride + dx
            coverage = load(guides, 6 * plane + neighbour)
            weight = splat(0.0)
            if bits(coverage > 0.0) != 0:
                cosine = nx * load(guides, neighbour) + ny * load(guides, plane + neighbour) + nz * load(guides, 2 * plane + neighbour)
                cosine = minimum(maximum(cosine, splat(0.0)), splat(1.0))
                for _ in range(doublings):
                    cosine = cosine * cosine
                step = _absolute(right * np.float32(dx) + down * np.float32(dy)) + epsilon
                depth = exp(_absolute(load(guides, 3 * plane + neighbour) - z) / step * -1.0)
                weight = cosine * depth * minimum(coverage, splat(1.0)) * (spatial[dy + reach, dx + reach] * WHOLE)
            store_uint16(weights, tap, weight + HALF)
            tap += 8


@helper
def _mean(first, weights, begin, reach, stride, values):
    """Return the mean of `values` at the neighbours of 8 pixels, values[first..], by the weights[begin..]; 0 where all weights are 0."""
    total, acc = splat(0.0), splat(0.0)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            weight = load_uint16(weights, begin)
            begin += 8
            total = total + weight
            acc = acc + weight * load(values, first + dy * stride + dx)
    return acc / maximum(total, splat(HALF))


@helper
def _means(at, weights, begin, reach, stride, plane, values):
    """Return the means of four planes, see `_mean`."""
    total, a, b, c, d = splat(0.0), splat(0.0), splat(0.0), splat(0.0), splat(0.0)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            weight, neighbour = load_uint16(weights, begin), at + dy * stride + dx
            begin += 8
            total = total + weight
            a = a + weight * load(values, neighbour)
            b = b + weight * load(values, plane + neighbour)
            c = c + weight * load(values, 2 * plane + neighbour)
            d = d + weight * load(values, 3 * plane + neighbour)
    scale = 1.0 / maximum(total, splat(HALF))
    return a * scale, b * scale, c * scale, d * scale


@kernel
def weigh_range(begin, end, groups, guides, spatial, epsilon, doublings, stride, plane, weights):
    """Compute the weights (groups, T T, 8), flat uint16, of groups begin..end, to be kept for the kernels below.

    spatial: (T, T), T odd. The exponent of n.n' is 2^doublings.
    """
    size = spatial.size * 8
    for i in range(begin, end):
        _weigh(groups[i], guides, spatial, epsilon, doublings, stride, plane, weights, i * size)


@helper
def _weights_of(i, groups, kept, guides, spatial, epsilon, doublings, stride, plane, own):
    """Return where the weights of group i begin in `kept`, or where that is empty compute them in `own`."""
    if len(kept) > 0:
        return i * spatial.size * 8
    _weigh(groups[i], guides, spatial, epsilon, doublings, stride, plane, own, 0)
    return 0


@kernel
def mean_range(begin, end, groups, kept, guides, spatial, epsilon, doublings, stride, plane, values, out):
    """Filter `values` (C planes) into `out` (C planes) for groups begin..end.

    kept: weights from `weigh_range`; empty: they are computed and not stored.
    """
    own, reach = np.empty(spatial.size * 8, np.uint16), spatial.shape[0] // 2
    weights = kept if len(kept) > 0 else own
    for i in range(begin, end):
        at = _weights_of(i, groups, kept, guides, spatial, epsilon, doublings, stride, plane, own)
        for first in range(groups[i], len(values), plane):
            store(out, first, _mean(first, weights, at, reach, stride, values))


@kernel
def smooth_range(begin, end, groups, kept, guides, spatial, epsilon, doublings, stride, plane, values, smooth, change):
    """Filter four planes like `mean_range`, and write to `change` (1 plane) the mean square by which this changes the first three."""
    own, reach = np.empty(spatial.size * 8, np.uint16), spatial.shape[0] // 2
    weights = kept if len(kept) > 0 else own
    for i in range(begin, end):
        begins, at = _weights_of(i, groups, kept, guides, spatial, epsilon, doublings, stride, plane, own), groups[i]
        a, b, c, d = _means(at, weights, begins, reach, stride, plane, values)
        store(smooth, at, a)
        store(smooth, plane + at, b)
        store(smooth, 2 * plane + at, c)
        store(smooth, 3 * plane + at, d)
        a, b, c = load(values, at) - a, load(values, plane + at) - b, load(values, 2 * plane + at) - c
        store(change, at, (a * a + b * b + c * c) * (1.0 / 3.0))


@kernel
def correct_range(begin, end, groups, kept, guides, spatial, epsilon, doublings, stride, plane, values, smooth, change, chance, out):
    """Blend the `values` (3 planes or more) back into what `smooth_range` made of them, for groups begin..end of `out` (3 planes).

    smooth: four planes; the last has the variance of the values' mean. chance: square of their relative error that is assumed as well.
    The reference in PyTorch operations is `corrected_reference` in core/relight/denoise.py.
    """
    own, reach = np.empty(spatial.size * 8, np.uint16), spatial.shape[0] // 2
    weights = kept if len(kept) > 0 else own
    for i in range(begin, end):
        begins, at = _weights_of(i, groups, kept, guides, spatial, epsilon, doublings, stride, plane, own), groups[i]
        s0, s1, s2 = load(smooth, at), load(smooth, plane + at), load(smooth, 2 * plane + at)
        variance = load(smooth, 3 * plane + at) + (s0 * s0 + s1 * s1 + s2 * s2) * (chance / 3.0)
        keep = splat(1.0) - variance / maximum(_mean(at, weights, begins, reach, stride, change), splat(1e-36))
        keep = minimum(maximum(keep, splat(0.0)), splat(1.0))
        store(out, at, s0 + keep * (load(values, at) - s0))
        store(out, plane + at, s1 + keep * (load(values, plane + at) - s1))
        store(out, 2 * plane + at, s2 + keep * (load(values, 2 * plane + at) - s2))
