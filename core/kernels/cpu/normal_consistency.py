# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels of the normal consistency loss and its analytic gradient; see core/kernels/normal_consistency.py.

The normal of the depth is n = c / |c| with c = dy x dx, where dx and dy are central differences of the points p = r z / alpha.
"""

from __future__ import annotations

import numpy as np

from .jit import helper, kernel


@helper
def _depth(image, y, x, floor):
    """Return the mean depth of a pixel, the sum of depths divided by opacity."""
    channels = image.shape[0]
    return image[channels - 2, y, x] / max(image[channels - 1, y, x], floor)


@kernel
def disagreement_range(begin, end, image, rays, rotation, floor, edge, gradient, slopes, sums):
    """Compute the loss of rows begin..end, none of them at the border, and its gradients.

    edge: disagreement from which the loss grows more slowly, see core/kernels/normal_consistency.py.
    gradient: (C, H, W) receives those of the splatted normals; slopes: (6, H + 2, W + 2) receives those of dx and dy, one pixel further;
    sums: (H,) receives the loss of each row, not divided by the number of pixels.
    """
    channels, height, width = image.shape
    share = np.float32(1.0 / (height * width))
    r = rotation
    for y in range(begin, end):
        total = 0.0
        for x in range(1, width - 1):
            right, left = _depth(image, y, x + 1, floor), _depth(image, y, x - 1, floor)
            below, above = _depth(image, y + 1, x, floor), _depth(image, y - 1, x, floor)
            dx0 = rays[0, y, x + 1] * right - rays[0, y, x - 1] * left
            dx1 = rays[1, y, x + 1] * right - rays[1, y, x - 1] * left
            dx2 = rays[2, y, x + 1] * right - rays[2, y, x - 1] * left
            dy0 = rays[0, y + 1, x] * below - rays[0, y - 1, x] * above
            dy1 = rays[1, y + 1, x] * below - rays[1, y - 1, x] * above
            dy2 = rays[2, y + 1, x] * below - rays[2, y - 1, x] * above
            c0, c1, c2 = dy1 * dx2 - dy2 * dx1, dy2 * dx0 - dy0 * dx2, dy0 * dx1 - dy1 * dx0
            inverse = np.float32(1.0) / np.sqrt(max(c0 * c0 + c1 * c1 + c2 * c2, np.float32(1e-20)))
            n0, n1, n2 = c0 * inverse, c1 * inverse, c2 * inverse
            w0, w1, w2 = image[3, y, x], image[4, y, x], image[5, y, x]
            s0 = r[0, 0] * w0 + r[0, 1] * w1 + r[0, 2] * w2
            s1 = r[1, 0] * w0 + r[1, 1] * w1 + r[1, 2] * w2
            s2 = r[2, 0] * w0 + r[2, 1] * w1 + r[2, 2] * w2
            agreement = s0 * n0 + s1 * n1 + s2 * n2
            disagreement = image[channels - 1, y, x] - agreement
            damping = np.float32(1.0) / (np.float32(1.0) + max(disagreement, np.float32(0.0)) / edge)
            total += disagreement * damping
            slope = share * damping * damping
            for j in range(3):
                gradient[3 + j, y, x] = -slope * (r[0, j] * n0 + r[1, j] * n1 + r[2, j] * n2)
            # d agreement / d c: the part of s across n, divided by |c|.
            g0, g1, g2 = (s0 - agreement * n0) * inverse, (s1 - agreement * n1) * inverse, (s2 - agreement * n2) * inverse
            g0, g1, g2 = -slope * g0, -slope * g1, -slope * g2
            slopes[0, y + 1, x + 1] = g1 * dy2 - g2 * dy1
            slopes[1, y + 1, x + 1] = g2 * dy0 - g0 * dy2
            slopes[2, y + 1, x + 1] = g0 * dy1 - g1 * dy0
            slopes[3, y + 1, x + 1] = dx1 * g2 - dx2 * g1
            slopes[4, y + 1, x + 1] = dx2 * g0 - dx0 * g2
            slopes[5, y + 1, x + 1] = dx0 * g1 - dx1 * g0
        sums[y] = total


@kernel
def depth_gradient_range(begin, end, image, rays, floor, slopes, gradient):
    """Gather the gradients of dx and dy at the points of rows begin..end, as gradients of depth sums and opacity in `gradient`."""
    channels, _, width = image.shape
    for y in range(begin, end):
        for x in range(width):
            g = np.float32(0.0)
            for j in range(3):
                across = slopes[j, y + 1, x] - slopes[j, y + 1, x + 2]
                g += rays[j, y, x] * (across + slopes[3 + j, y, x + 1] - slopes[3 + j, y + 2, x + 1])
            alpha = max(image[channels - 1, y, x], floor)
            gradient[channels - 2, y, x] = g / alpha
            free = image[channels - 1, y, x] > floor
            gradient[channels - 1, y, x] = -g * image[channels - 2, y, x] / (alpha * alpha) if free else np.float32(0.0)
