# SPDX-License-Identifier: GPL-3.0-or-later
"""The cross-bilateral filter: a mean over neighbours that lie on the same surface, 8 pixels of a row to a vector.

Weight of neighbour p' at p: exp(-|p - p'|^2 / 2 sigma^2) max(n.n', 0)^(2^k) exp(-|z - z'| / (|grad z . (p - p')| + epsilon)) times its
coverage. Guides: normal 3, depth, its slope per pixel to the right and down, coverage (0 = nothing there).
Pictures are channel planes, flattened, with `margin` empty pixels on every side so that no load leaves them.
"""

from __future__ import annotations

import numpy as np

from .jit import kernel
from .simd import bits, exp, load, maximum, minimum, select, splat, store


@kernel
def _absolute(x):
    return maximum(x, x * -1.0)


@kernel
def bilateral_range(begin, end, values, guides, spatial, epsilon, doublings, width, margin, stride, plane, out):
    """Filter rows begin..end of `values` (C planes) into `out`; spatial: (T, T) weights, T odd; 2^doublings is the normals' exponent."""
    channels = len(values) // plane
    reach = spatial.shape[0] // 2
    acc = np.empty(channels * 8, np.float32)
    for row in range(begin, end):
        for column in range(0, width, 8):
            at = (row + margin) * stride + column + margin
            covered = load(guides, 6 * plane + at) > 0.0
            if bits(covered) == 0:
                continue
            nx, ny, nz = load(guides, at), load(guides, plane + at), load(guides, 2 * plane + at)
            z, right, down = load(guides, 3 * plane + at), load(guides, 4 * plane + at), load(guides, 5 * plane + at)
            acc[:] = 0.0
            total = splat(0.0)
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    to = at + dy * stride + dx
                    coverage = load(guides, 6 * plane + to)
                    if bits(coverage > 0.0) == 0:
                        continue
                    cosine = nx * load(guides, to) + ny * load(guides, plane + to) + nz * load(guides, 2 * plane + to)
                    cosine = minimum(maximum(cosine, splat(0.0)), splat(1.0))
                    for _ in range(doublings):
                        cosine = cosine * cosine
                    step = _absolute(right * np.float32(dx) + down * np.float32(dy)) + epsilon
                    depth = exp(_absolute(load(guides, 3 * plane + to) - z) / step * -1.0)
                    weight = cosine * depth * coverage * spatial[dy + reach, dx + reach]
                    total = total + weight
                    for c in range(channels):
                        store(acc, c * 8, load(acc, c * 8) + weight * load(values, c * plane + to))
            scale = select(total > 0.0, 1.0 / select(total > 0.0, total, splat(1.0)), splat(0.0))
            for c in range(channels):
                store(out, c * plane + at, select(covered, load(acc, c * 8) * scale, splat(0.0)))
