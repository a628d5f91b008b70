# SPDX-License-Identifier: GPL-3.0-or-later
"""Projection of 2D Gaussians to screen-space splats, and its adjoint, 8 Gaussians to a vector.

A surfel with centre c, tangents t_u, t_v, scales s_u, s_v (camera space, z forward) is hit by the ray of a pixel at offset
(dx, dy) from its projected centre at

    u = (A.d) / w,   v = (B.d) / w,   depth = c_z / w,   w = 1 + C.d

an exact plane intersection (2DGS, eq. 8) without cancellation at the centre. The record of a splat holds these numbers.

Parameters are structure-of-arrays, flattened: position (3 N), quaternion (4 N, w x y z, any length), log scale (2 N),
opacity logit (N), sh (K 3 N).
"""

from __future__ import annotations

import math

import numpy as np

from ..constants import ALPHA_MIN, LOG_SCALE_MIN, LOW_PASS, SPLAT_GRADIENTS
from .frame import add, cross, dot, frame, quaternion_gradient, rotate_back, scaled
from .harmonics import basis, basis_gradient
from .jit import helper, kernel
from .simd import load, maximum, select, splat, sqrt, store
from .simd_math import exp


@helper
def _sigmoid(x):
    """Return 1 / (1 + e^-x)."""
    return 1.0 / (1.0 + exp(x * -1.0))


@helper
def _log_scale(log_scale, i):
    """Return 8 log scales, clamped to LOG_SCALE_MIN."""
    return maximum(load(log_scale, i), splat(LOG_SCALE_MIN))


@helper
def _slopes(c, tu, tv, excess):
    """Return t_u nc - n (t_u . c), and the same for t_v: multiplied by the offset of a pixel they are proportional to u and v.

    As cross products they have no cancellation. `excess` is what the clamp added to the foreshortening: without it such a surfel would be
    drawn longer.
    """
    return add(cross(tv, c), scaled(tu, excess)), add(cross(c, tu), scaled(tv, excess))


@helper
def _direction(offset):
    """Return the unit viewing direction, camera to Gaussian, and 1 / distance."""
    inv = 1.0 / sqrt(maximum(dot(offset, offset), splat(1e-20)))
    return scaled(offset, inv), inv


@kernel
def project_range(begin, end, position, quaternion, log_scale, opacity, sh, extra, coefficients, cam, n, record, feature, box, depth):
    """Fill splat records (N, SPLAT_RECORD), features (N, F: colour, normal, extra), pixel boxes (N, 4) and depth (N,).

    box: x0 y0 x1 y1, inclusive; x0 > x1 where culled.
    cam: row-major world-to-camera rotation (9), fx fy cx cy (4), camera centre (3), width, height, near depth.
    `begin` and `end` count blocks of 8; the last block overlaps its neighbour where N is no multiple of 8.
    """
    scratch = np.empty(24 * 8, np.float32)
    values = np.empty(16 * 8, np.float32)
    fx, fy, px, py = cam[9], cam[10], cam[11], cam[12]
    extras = feature.shape[1] - 6
    for block in range(begin, end):
        i = min(block * 8, n - 8)
        offset, c, r2, tu, tv, normal, nc, facing, free, _, _ = frame(position, quaternion, n, i, cam)
        su, sv = exp(_log_scale(log_scale, i)), exp(_log_scale(log_scale, n + i))
        z = select(c[2] > cam[18], c[2], splat(1.0))
        k, iz = z / nc, 1.0 / z
        e, f = _slopes(c, tu, tv, select(free, splat(0.0), nc - dot(normal, c)))
        ku, kv = k / su, k / sv
        store(scratch, 0, c[0] * iz * fx + px)
        store(scratch, 8, c[1] * iz * fy + py)
        store(scratch, 16, e[0] * ku / fx)
        store(scratch, 24, e[1] * ku / fy)
        store(scratch, 32, f[0] * kv / fx)
        store(scratch, 40, f[1] * kv / fy)
        store(scratch, 48, normal[0] * k / fx)
        store(scratch, 56, normal[1] * k / fy)
        store(scratch, 64, c[2])
        store(scratch, 72, _sigmoid(load(opacity, i)))
        # Second moments of the surfel for its bounding box.
        store(scratch, 96, tu[0] * tu[0] * su * su + tv[0] * tv[0] * sv * sv)
        store(scratch, 104, tu[1] * tu[1] * su * su + tv[1] * tv[1] * sv * sv)
        store(scratch, 112, tu[2] * tu[2] * su * su + tv[2] * tv[2] * sv * sv)
        store(scratch, 120, tu[0] * tu[2] * su * su + tv[0] * tv[2] * sv * sv)
        store(scratch, 128, tu[1] * tu[2] * su * su + tv[1] * tv[2] * sv * sv)
        store(scratch, 136, c[0])
        store(scratch, 144, c[1])
        direction, _ = _direction(offset)
        basis(direction[0], direction[1], direction[2], coefficients, values)
        for channel in range(3):
            colour = splat(0.5)
            for j in range(coefficients):
                colour = colour + load(values, j * 8) * load(sh, (j * 3 + channel) * n + i)
            store(scratch, 152 + channel * 8, maximum(colour, splat(0.0)))
            for lane in range(8):
                feature[i + lane, channel] = scratch[152 + channel * 8 + lane]
            store(scratch, 152 + channel * 8, r2[channel] * facing)
            for lane in range(8):
                feature[i + lane, 3 + channel] = scratch[152 + channel * 8 + lane]
        for lane in range(8):
            for channel in range(extras):
                feature[i + lane, 6 + channel] = extra[channel * n + i + lane]
            _finish(i + lane, lane, scratch, cam, record, box, depth)


@helper
def _finish(g, lane, scratch, cam, record, box, depth):
    """Write the record, cut-off and pixel box of Gaussian g from the scratch memory of its block."""
    for j in range(SPLAT_GRADIENTS):
        record[g, j] = scratch[j * 8 + lane]
    z, alpha = record[g, 8], record[g, 9]
    depth[g] = z
    box[g, 0], box[g, 1], box[g, 2], box[g, 3] = 1, 1, 0, 0
    record[g, 10] = 0.0
    if not (z > cam[18]) or not (alpha > ALPHA_MIN):
        return
    cut = np.float32(2.0 * math.log(alpha / ALPHA_MIN))
    record[g, 10] = cut
    # Extent of the ellipse rho = cut under perspective: a quadratic in x/z with these coefficients.
    d = cut * scratch[112 + lane] - z * z
    surrounds_camera = d > -cam[18] * cam[18]  # the surfel extends behind the camera and may cover any pixel
    pad = math.sqrt(cut / LOW_PASS)
    for axis in range(2):
        c, focal, shift, limit = scratch[136 + axis * 8 + lane], cam[9 + axis], cam[11 + axis], cam[16 + axis]
        low, high = np.float32(0.0), limit
        if not surrounds_camera:
            middle = (cut * scratch[120 + axis * 8 + lane] - c * z) / d
            spread = math.sqrt(max(0.0, middle * middle - (cut * scratch[96 + axis * 8 + lane] - c * c) / d))
            low = min((middle - spread) * focal + shift, record[g, axis] - pad)
            high = max((middle + spread) * focal + shift, record[g, axis] + pad)
        first, last = max(0.0, math.ceil(low - 0.5)), min(limit - 1.0, math.floor(high - 0.5))
        if not (first <= last):
            box[g, 0], box[g, 2] = 1, 0
            return
        box[g, axis], box[g, 2 + axis] = int(first), int(last)


@helper
def _sum_slots(slots, touched, first, sums):
    """Sum the gradients of 8 Gaussians over the threads' slots, in the order of the slots, to `sums` (columns * 8,).

    Returns: True where any of them has a gradient; Gaussians behind opaque surfaces have none.
    """
    found = False
    for slot in range(slots.shape[0]):
        for lane in range(8):
            found = found or touched[slot, first + lane] != 0
    if not found:
        return False
    sums[:] = 0.0
    for slot in range(slots.shape[0]):
        for lane in range(8):
            if touched[slot, first + lane] != 0:
                for column in range(slots.shape[2]):
                    sums[column * 8 + lane] += slots[slot, first + lane, column]
    return True


@helper
def _column(sums, column):
    """Return one column of the gradients that `_sum_slots` summed, of 8 Gaussians."""
    return load(sums, column * 8)


@helper
def _clear(g_position, g_quaternion, g_log_scale, g_opacity, g_sh, g_extra, screen, coefficients, extras, n, i):
    """Write zero gradients for 8 Gaussians."""
    zero = splat(0.0)
    for j in range(3):
        store(g_position, j * n + i, zero)
    for j in range(4):
        store(g_quaternion, j * n + i, zero)
    for j in range(2):
        store(g_log_scale, j * n + i, zero)
    for j in range(3 * coefficients):
        store(g_sh, j * n + i, zero)
    for j in range(extras):
        store(g_extra, j * n + i, zero)
    store(g_opacity, i, zero)
    store(screen, i, zero)


@kernel
def project_backward_range(
    begin, end, position, quaternion, log_scale, opacity, sh, coefficients, cam, n, slots, touched,
    g_position, g_quaternion, g_log_scale, g_opacity, g_sh, g_extra, screen,
):  # fmt: skip
    """Compute the adjoint of `project_range`: from `slots` (threads, N, W) to gradients laid out like the parameters.

    touched: (threads, N), 0 for rows of `slots` that hold no gradient.
    screen: (N,) receives |d loss / d projected centre| per pixel.
    """
    sums = np.empty(slots.shape[2] * 8, np.float32)
    values = np.empty(16 * 8, np.float32)
    slopes = np.empty(3 * 16 * 8, np.float32)
    fx, fy = cam[9], cam[10]
    extras = len(g_extra) // n
    zero = splat(0.0)
    for block in range(begin, end):
        i = min(block * 8, n - 8)
        if not _sum_slots(slots, touched, i, sums):
            _clear(g_position, g_quaternion, g_log_scale, g_opacity, g_sh, g_extra, screen, coefficients, extras, n, i)
            continue
        offset, c, _, tu, tv, normal, nc, facing, free, q, qinv = frame(position, quaternion, n, i, cam)
        isu, isv = exp(_log_scale(log_scale, i) * -1.0), exp(_log_scale(log_scale, n + i) * -1.0)
        front = c[2] > cam[18]
        z = select(front, c[2], splat(1.0))
        k, iz = z / nc, 1.0 / z
        excess = select(free, zero, nc - dot(normal, c))
        e, f = _slopes(c, tu, tv, excess)
        gmx, gmy = _column(sums, 0), _column(sums, 1)
        ga0, ga1 = _column(sums, 2) * isu / fx, _column(sums, 3) * isu / fy
        gb0, gb1 = _column(sums, 4) * isv / fx, _column(sums, 5) * isv / fy
        gc0, gc1 = _column(sums, 6) / fx, _column(sums, 7) / fy
        au, bv = ga0 * e[0] + ga1 * e[1], gb0 * f[0] + gb1 * f[1]
        gk = au + bv + gc0 * normal[0] + gc1 * normal[1]
        ge, gf = (ga0 * k, ga1 * k, zero), (gb0 * k, gb1 * k, zero)
        gnc = select(free, gk * k * -1.0 / nc, zero)
        gn = add((gc0 * k, gc1 * k, zero), scaled(c, gnc))
        g_excess = select(free, zero, (dot(ge, tu) + dot(gf, tv)) * -1.0)
        gn = add(gn, scaled(c, g_excess))
        g_tv, g_tu = add(cross(c, ge), scaled(gf, excess)), add(cross(gf, c), scaled(ge, excess))
        g_c = add(add(cross(ge, tv), cross(tu, gf)), scaled(normal, gnc + g_excess))
        gz = gk / nc + _column(sums, 8) - (gmx * fx * c[0] + gmy * fy * c[1]) * iz * iz
        g_c = add(g_c, (gmx * fx * iz, gmy * fy * iz, gz))
        g_world = rotate_back(cam, g_c)
        store(g_log_scale, i, au * k * -1.0)
        store(g_log_scale, n + i, bv * k * -1.0)
        store(screen, i, sqrt(gmx * gmx + gmy * gmy))
        o = _sigmoid(load(opacity, i))
        store(g_opacity, i, _column(sums, 9) * o * (1.0 - o))
        g_normal = (_column(sums, 13), _column(sums, 14), _column(sums, 15))
        g2 = add(rotate_back(cam, gn), scaled(g_normal, facing))
        gq = quaternion_gradient(q, qinv, rotate_back(cam, g_tu), rotate_back(cam, g_tv), g2)
        for j in range(4):
            store(g_quaternion, j * n + i, gq[j])
        direction, inv_distance = _direction(offset)
        basis(direction[0], direction[1], direction[2], coefficients, values)
        basis_gradient(direction[0], direction[1], direction[2], coefficients, slopes)
        gdx, gdy, gdz = zero, zero, zero
        for channel in range(3):
            colour = splat(0.5)
            for j in range(coefficients):
                colour = colour + load(values, j * 8) * load(sh, (j * 3 + channel) * n + i)
            g = select(colour > 0.0, _column(sums, SPLAT_GRADIENTS + channel), zero)
            for j in range(coefficients):
                at = (j * 3 + channel) * n + i
                store(g_sh, at, load(values, j * 8) * g)
                weight = load(sh, at) * g
                gdx = gdx + load(slopes, j * 8) * weight
                gdy = gdy + load(slopes, 128 + j * 8) * weight
                gdz = gdz + load(slopes, 256 + j * 8) * weight
        radial = gdx * direction[0] + gdy * direction[1] + gdz * direction[2]
        gd = ((gdx - direction[0] * radial), (gdy - direction[1] * radial), (gdz - direction[2] * radial))
        g_world = add(g_world, scaled(gd, inv_distance))
        for j in range(3):
            store(g_position, j * n + i, select(front, g_world[j], zero))
        for channel in range(extras):
            store(g_extra, channel * n + i, _column(sums, SPLAT_GRADIENTS + 6 + channel))
