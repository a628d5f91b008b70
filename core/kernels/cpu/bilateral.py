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
from .simd import bits, exp, load, maximum, minimum, select, splat, store


@helper
def _absolute(x):
    """Return |x| of a vector."""
    return maximum(x, x * -1.0)


@helper
def _weigh(at, guides, spatial, epsilon, doublings, stride, plane, weights, to):
    """Write the weights of the group `at`, a vector for each neighbour, to weights[to..]; they sum to 1."""
    reach = spatial.shape[0] // 2
    nx, ny, nz = load(guides, at), load(guides, plane + at), load(guides, 2 * plane + at)
    z, right, down = load(guides, 3 * plane + at), load(guides, 4 * plane + at), load(guides, 5 * plane + at)
    total = splat(0.0)
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
                weight = cosine * depth * coverage * spatial[dy + reach, dx + reach]
            total = total + weight
            store(weights, tap, weight)
            tap += 8
    scale = select(total > 0.0, 1.0 / select(total > 0.0, total, splat(1.0)), splat(0.0))
    for i in range(to, tap, 8):
        store(weights, i, load(weights, i) * scale)


@helper
def _mean(at, values, weights, begin, reach, stride, plane, acc, out):
    """Write the weighted mean of the neighbours of the group `at` to `out`, in every plane of `values`."""
    channels = len(values) // plane
    acc[:] = 0.0
    tap = begin
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            neighbour = at + dy * stride + dx
            weight = load(weights, tap)
            tap += 8
            for c in range(channels):
                store(acc, c * 8, load(acc, c * 8) + weight * load(values, c * plane + neighbour))
    for c in range(channels):
        store(out, c * plane + at, load(acc, c * 8))


@kernel
def weigh_range(begin, end, groups, guides, spatial, epsilon, doublings, stride, plane, weights):
    """Compute the weights (groups, T T, 8), flat, of groups begin..end, to be kept for the kernels below.

    spatial: (T, T), T odd. The exponent of n.n' is 2^doublings.
    """
    size = spatial.size * 8
    for i in range(begin, end):
        _weigh(groups[i], guides, spatial, epsilon, doublings, stride, plane, weights, i * size)


@helper
def _filter(i, groups, kept, guides, spatial, epsilon, doublings, stride, plane, own, values, acc, out):
    """Write the weighted mean of the neighbours of group i to `out`, by the weights `kept`, or where that is empty by computed ones."""
    weights, begin = kept, i * spatial.size * 8
    if len(kept) == 0:
        _weigh(groups[i], guides, spatial, epsilon, doublings, stride, plane, own, 0)
        weights, begin = own, 0
    _mean(groups[i], values, weights, begin, spatial.shape[0] // 2, stride, plane, acc, out)


@kernel
def mean_range(begin, end, groups, kept, guides, spatial, epsilon, doublings, stride, plane, values, out):
    """Filter `values` (C planes) into `out` (C planes) for groups begin..end.

    kept: weights from `weigh_range`; empty: they are computed and not stored.
    """
    own = np.empty(spatial.size * 8, np.float32)
    acc = np.empty(len(values) // plane * 8, np.float32)
    for i in range(begin, end):
        _filter(i, groups, kept, guides, spatial, epsilon, doublings, stride, plane, own, values, acc, out)


@kernel
def smooth_range(begin, end, groups, kept, guides, spatial, epsilon, doublings, stride, plane, values, smooth, change):
    """Filter like `mean_range`, and write to `change` (1 plane) the mean square by which this changes the first three planes."""
    own = np.empty(spatial.size * 8, np.float32)
    acc = np.empty(len(values) // plane * 8, np.float32)
    for i in range(begin, end):
        _filter(i, groups, kept, guides, spatial, epsilon, doublings, stride, plane, own, values, acc, smooth)
        at, total = groups[i], splat(0.0)
        for c in range(3):
            difference = load(values, c * plane + at) - load(smooth, c * plane + at)
            total = total + difference * difference
        store(change, at, total * (1.0 / 3.0))


@kernel
def correct_range(begin, end, groups, kept, guides, spatial, epsilon, doublings, stride, plane, values, smooth, change, chance, out):
    """Blend the `values` (3 planes or more) back into what `smooth_range` made of them, for groups begin..end of `out` (3 planes).

    smooth: four planes; the last has the variance of the values' mean. chance: square of their relative error that is assumed as well.
    The reference in PyTorch operations is `corrected_reference` in core/relight/denoise.py.
    """
    own = np.empty(spatial.size * 8, np.float32)
    acc = np.empty(8, np.float32)
    for i in range(begin, end):
        _filter(i, groups, kept, guides, spatial, epsilon, doublings, stride, plane, own, change, acc, out)  # replaced below
        at = groups[i]
        s0, s1, s2 = load(smooth, at), load(smooth, plane + at), load(smooth, 2 * plane + at)
        variance = load(smooth, 3 * plane + at) + (s0 * s0 + s1 * s1 + s2 * s2) * (chance / 3.0)
        keep = splat(1.0) - variance / maximum(load(out, at), splat(1e-36))
        keep = minimum(maximum(keep, splat(0.0)), splat(1.0))
        store(out, at, s0 + keep * (load(values, at) - s0))
        store(out, plane + at, s1 + keep * (load(values, plane + at) - s1))
        store(out, 2 * plane + at, s2 + keep * (load(values, 2 * plane + at) - s2))
