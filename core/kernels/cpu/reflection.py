# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels of BRDF-weighted sums over light samples and of their gradients, in one pass over memory; see core/kernels/reflection.py.

The references in PyTorch operations are `specular_lobe` and `irgs_lobe` in core/shading/brdf.py, which define the names.
"""

from __future__ import annotations

import math

from ..constants import IRGS_DENOMINATOR, IRGS_FRESNEL, SHORTEST2
from .fresnel import fresnel_slope, fresnel_weight
from .jit import helper, kernel

LEAST_DENOMINATOR, LARGEST_DENOMINATOR = IRGS_DENOMINATOR
FRESNEL_SQUARE, FRESNEL_LINEAR = IRGS_FRESNEL


@helper
def point_terms(view, normal, alpha, p):
    """Return the arguments of `specular_terms` at point p: normal, view, alpha^2, n.v and root_v."""
    nx, ny, nz = float(normal[p, 0]), float(normal[p, 1]), float(normal[p, 2])
    vx, vy, vz = float(view[p, 0]), float(view[p, 1]), float(view[p, 2])
    a2 = float(alpha[p]) * float(alpha[p])
    n_v = nx * vx + ny * vy + nz * vz
    return (nx, ny, nz), (vx, vy, vz), a2, n_v, math.sqrt(n_v * n_v * (1 - a2) + a2)


@helper
def specular_terms(nx, ny, nz, vx, vy, vz, dx, dy, dz, n_l, n_v, root_v, a2):
    """Return D V (1 - w) and D V w, w the Fresnel weight, for normal n, view v and direction d.

    root_v = sqrt(n.v^2 (1 - alpha^2) + alpha^2).
    """
    hx, hy, hz = dx + vx, dy + vy, dz + vz
    length2 = max(hx * hx + hy * hy + hz * hz, SHORTEST2)
    n_h = n_l + n_v
    tx, ty, tz = hx - n_h * nx, hy - n_h * ny, hz - n_h * nz
    k = a2 + (tx * tx + ty * ty + tz * tz) / length2 * (1 - a2)
    sum_l = n_l * root_v + n_v * math.sqrt(n_l * n_l * (1 - a2) + a2)
    value = a2 / (math.pi * k * k) * 0.5 / sum_l
    bias = value * fresnel_weight(max(1 - 0.5 * math.sqrt(length2), 0.0))
    return value - bias, bias


@helper
def irgs_terms(nx, ny, nz, vx, vy, vz, dx, dy, dz, n_l, n_v, a2):
    """Return the two parts of IRGS' specular lobe, which F0 scales and Fresnel adds, for normal n, view v and direction d; a2 = alpha^2."""
    hx, hy, hz = dx + vx, dy + vy, dz + vz
    length2 = max(hx * hx + hy * hy + hz * hz, SHORTEST2)
    n_h = n_l + n_v
    tx, ty, tz = hx - n_h * nx, hy - n_h * ny, hz - n_h * nz
    k = a2 + (tx * tx + ty * ty + tz * tz) / length2 * (1 - a2)
    grown = math.sqrt(math.sqrt(a2)) + 1
    share = grown * grown * 0.125
    denominator = 4 * math.pi * k * k * (n_v * (1 - share) + share) * (n_l * (1 - share) + share)
    value = a2 / min(max(denominator, LEAST_DENOMINATOR), LARGEST_DENOMINATOR)
    v_h = 0.5 * math.sqrt(length2)
    bias = value * 2.0 ** ((FRESNEL_SQUARE * v_h + FRESNEL_LINEAR) * v_h)
    return value - bias, bias


@kernel
def reflect_range(begin, end, view, normal, alpha, direction, density, incoming, sums):
    """Write, for points begin..end, sums (P, 9) of incoming light weighted for the diffuse lobe, for F0 and for what Fresnel adds."""
    count = density.shape[1]
    for p in range(begin, end):
        (nx, ny, nz), (vx, vy, vz), a2, n_v, root_v = point_terms(view, normal, alpha, p)
        s0, s1, s2, s3, s4, s5, s6, s7, s8 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            dx, dy, dz = float(direction[p, i, 0]), float(direction[p, i, 1]), float(direction[p, i, 2])
            n_l = nx * dx + ny * dy + nz * dz
            if n_l <= 0:
                continue
            weight = n_l / (float(density[p, i]) * count)
            value, bias = specular_terms(nx, ny, nz, vx, vy, vz, dx, dy, dz, n_l, n_v, root_v, a2)
            value, bias = value * weight, bias * weight
            r, g, b = float(incoming[p, i, 0]), float(incoming[p, i, 1]), float(incoming[p, i, 2])
            s0, s1, s2 = s0 + weight * r, s1 + weight * g, s2 + weight * b
            s3, s4, s5 = s3 + value * r, s4 + value * g, s5 + value * b
            s6, s7, s8 = s6 + bias * r, s7 + bias * g, s8 + bias * b
        sums[p, 0], sums[p, 1], sums[p, 2] = s0, s1, s2
        sums[p, 3], sums[p, 4], sums[p, 5] = s3, s4, s5
        sums[p, 6], sums[p, 7], sums[p, 8] = s6, s7, s8


@kernel
def reflect_backward_range(begin, end, view, normal, alpha, direction, density, incoming, gradient, d_point, d_incoming):
    """Compute the adjoint of `reflect_range` from `gradient` (P, 9) of the sums.

    Writes `d_point` (P, 7), the gradients of view, normal and alpha, and `d_incoming` (P, N, 3).
    """
    count = density.shape[1]
    for p in range(begin, end):
        nx, ny, nz = float(normal[p, 0]), float(normal[p, 1]), float(normal[p, 2])
        vx, vy, vz = float(view[p, 0]), float(view[p, 1]), float(view[p, 2])
        g0, g1, g2 = float(gradient[p, 0]), float(gradient[p, 1]), float(gradient[p, 2])
        g3, g4, g5 = float(gradient[p, 3]), float(gradient[p, 4]), float(gradient[p, 5])
        g6, g7, g8 = float(gradient[p, 6]), float(gradient[p, 7]), float(gradient[p, 8])
        a2 = float(alpha[p]) * float(alpha[p])
        n_v = nx * vx + ny * vy + nz * vz
        root_v = math.sqrt(n_v * n_v * (1 - a2) + a2)
        d_n_v, d_a2 = 0.0, 0.0
        dvx, dvy, dvz, dnx, dny, dnz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            dx, dy, dz = float(direction[p, i, 0]), float(direction[p, i, 1]), float(direction[p, i, 2])
            n_l = nx * dx + ny * dy + nz * dz
            if n_l <= 0:
                d_incoming[p, i, 0], d_incoming[p, i, 1], d_incoming[p, i, 2] = 0.0, 0.0, 0.0
                continue
            hx, hy, hz = dx + vx, dy + vy, dz + vz
            length2 = max(hx * hx + hy * hy + hz * hz, SHORTEST2)
            n_h = n_l + n_v
            tx, ty, tz = hx - n_h * nx, hy - n_h * ny, hz - n_h * nz
            sine2 = (tx * tx + ty * ty + tz * tz) / length2
            k = a2 + sine2 * (1 - a2)
            root_l = math.sqrt(n_l * n_l * (1 - a2) + a2)
            sum_l = n_l * root_v + n_v * root_l
            inverse_density = 1 / (float(density[p, i]) * count)
            weight = n_l * inverse_density
            distribution = a2 / (math.pi * k * k)
            visibility = 0.5 / sum_l
            length = math.sqrt(length2)
            x = max(1 - 0.5 * length, 0.0)
            fresnel = fresnel_weight(x)
            value = distribution * visibility * weight
            scaled = value * (1 - fresnel)
            bias = value * fresnel
            d_incoming[p, i, 0] = weight * g0 + scaled * g3 + bias * g6
            d_incoming[p, i, 1] = weight * g1 + scaled * g4 + bias * g7
            d_incoming[p, i, 2] = weight * g2 + scaled * g5 + bias * g8

            r, g, b = float(incoming[p, i, 0]), float(incoming[p, i, 1]), float(incoming[p, i, 2])
            d_scaled, d_bias = g3 * r + g4 * g + g5 * b, g6 * r + g7 * g + g8 * b
            d_value = d_scaled * (1 - fresnel) + d_bias * fresnel
            d_weight = g0 * r + g1 * g + g2 * b + d_value * distribution * visibility
            d_n_l = d_weight * inverse_density
            # visibility = 0.5 / (n_l root_v + n_v root_l)
            d_sum = -2 * visibility * visibility * d_value * distribution * weight
            d_n_l += d_sum * (root_v + n_v * n_l * (1 - a2) / root_l)
            d_n_v += d_sum * (root_l + n_l * n_v * (1 - a2) / root_v)
            d_a2 += 0.5 * d_sum * (n_l * (1 - n_v * n_v) / root_v + n_v * (1 - n_l * n_l) / root_l)
            # distribution = a2 / (pi k^2), k = a2 + sine2 (1 - a2)
            d_distribution = d_value * visibility * weight
            d_k = -2 * distribution / k * d_distribution
            d_a2 += d_distribution * distribution / a2 + d_k * (1 - sine2)
            # sine2 = t.t / length2, t = h - n_h n
            d_sine2 = d_k * (1 - a2) / length2
            d_fresnel = value * (d_bias - d_scaled)
            d_length2 = -d_sine2 * sine2 - 0.25 * fresnel_slope(x) * d_fresnel / length
            if length2 <= SHORTEST2:
                d_length2 = 0.0
            d_t = 2 * d_sine2
            d_n_h = -d_t * (tx * nx + ty * ny + tz * nz)
            d_n_l += d_n_h
            d_n_v += d_n_h
            d_h = 2 * d_length2
            dvx += d_t * tx + d_h * hx
            dvy += d_t * ty + d_h * hy
            dvz += d_t * tz + d_h * hz
            dnx += d_n_l * dx - d_t * n_h * tx
            dny += d_n_l * dy - d_t * n_h * ty
            dnz += d_n_l * dz - d_t * n_h * tz
        d_point[p, 0], d_point[p, 1], d_point[p, 2] = dvx + d_n_v * nx, dvy + d_n_v * ny, dvz + d_n_v * nz
        d_point[p, 3], d_point[p, 4], d_point[p, 5] = dnx + d_n_v * vx, dny + d_n_v * vy, dnz + d_n_v * vz
        d_point[p, 6] = 2 * float(alpha[p]) * d_a2
