# SPDX-License-Identifier: GPL-3.0-or-later
"""Compositing of splats on the GPU, a thread per pixel of a tile; the formulas are in core/kernels/cpu/raster.py.

A warp covers four rows of a tile. In the backward pass its threads sum their gradients of a splat and the first thread writes the sum to a
place of its own: no sum depends on the order in which threads run.
"""

from functools import cache
from typing import Any

import warp as wp

from ..constants import ALPHA_MAX, HORIZON_MIN, LOW_PASS, SPLAT_GRADIENTS, TILE, TRANSMITTANCE_MIN
from .runtime import LANES, any_lane, lane_sum, leads

PIXELS = TILE * TILE
PARTS = PIXELS // LANES  # warps to a tile
_SIDE, _PIXELS, _PARTS, _LANES = wp.constant(TILE), wp.constant(PIXELS), wp.constant(PARTS), wp.constant(LANES)
_LOW_PASS, _AHEAD = wp.constant(LOW_PASS), wp.constant(HORIZON_MIN)
_ALPHA_MAX, _OPAQUE = wp.constant(ALPHA_MAX), wp.constant(TRANSMITTANCE_MIN)
_GEOMETRY = wp.constant(SPLAT_GRADIENTS)


@wp.struct
class Crossing:
    """Intersection of a pixel's ray with a surfel."""

    rho: float
    iw: float
    u: float
    v: float
    filtered: int


@wp.func
def crossing(record: wp.array2d(dtype=float), g: int, dx: float, dy: float) -> Crossing:
    """Intersect the ray at pixel offset dx, dy from a splat's centre with its surfel."""
    c = Crossing()
    w = 1.0 + dx * record[g, 6] + dy * record[g, 7]
    ahead = w > _AHEAD
    c.iw = 1.0 / wp.where(ahead, w, 1.0)
    c.u = (dx * record[g, 2] + dy * record[g, 3]) * c.iw
    c.v = (dx * record[g, 4] + dy * record[g, 5]) * c.iw
    rho = wp.where(ahead, c.u * c.u + c.v * c.v, 1.0e9)
    flat = _LOW_PASS * (dx * dx + dy * dy)
    c.filtered = int(rho > flat)
    c.rho = wp.min(rho, flat)
    return c


@wp.func
def pixel_of(thread: int, columns: int) -> wp.vec2i:
    """Return column and row of the pixel of a thread."""
    tile, place = thread / _PIXELS, thread % _PIXELS
    return wp.vec2i((tile % columns) * _SIDE + place % _SIDE, (tile / columns) * _SIDE + place / _SIDE)


@cache
def kernels(features: int) -> tuple[Any, Any]:
    """Return the forward and the backward kernel for a number of features: a constant number lets them stay in registers."""
    Row = wp.types.vector(length=features, dtype=wp.float32)
    Gradient = wp.types.vector(length=SPLAT_GRADIENTS + features, dtype=wp.float32)
    count = features

    @wp.kernel(module="unique")
    def composite(
        start: wp.array(dtype=int), index: wp.array(dtype=wp.int64), owner: wp.array(dtype=int), record: wp.array2d(dtype=float),
        feature: wp.array2d(dtype=float), box: wp.array(dtype=wp.vec4i), columns: int, width: int, height: int,
        image: wp.array(dtype=float),
    ):  # fmt: skip
        """Composite the splats of each tile into image (C, H, W) flat: features, depth, opacity, transmittance."""
        thread = wp.tid()
        pixel = pixel_of(thread, columns)
        if pixel[0] >= width or pixel[1] >= height:
            return
        x, y = float(pixel[0]) + 0.5, float(pixel[1]) + 0.5
        tile = thread / _PIXELS
        acc = Row(0.0)
        depth, before = float(0.0), float(1.0)
        for entry in range(start[tile], start[tile + 1]):
            g = owner[index[entry]]
            rows = box[g]
            if pixel[1] >= rows[1] and pixel[1] <= rows[3]:
                c = crossing(record, g, x - record[g, 0], y - record[g, 1])
                if c.rho <= record[g, 10]:
                    weight = before * wp.min(wp.exp(-0.5 * c.rho) * record[g, 9], _ALPHA_MAX)
                    before -= weight
                    for j in range(count):
                        acc[j] += weight * feature[g, j]
                    depth += weight * record[g, 8] * wp.where(c.filtered == 1, 1.0, c.iw)
                    if before <= _OPAQUE:
                        break
        opaque = before <= _OPAQUE
        scale = wp.where(opaque, 1.0 / (1.0 - before), 1.0)
        at, plane = pixel[1] * width + pixel[0], width * height
        for j in range(count):
            image[j * plane + at] = acc[j] * scale
        image[count * plane + at] = depth * scale
        image[(count + 1) * plane + at] = wp.where(opaque, 1.0, 1.0 - before)
        image[(count + 2) * plane + at] = before

    @wp.kernel(module="unique")
    def composite_backward(
        start: wp.array(dtype=int), index: wp.array(dtype=wp.int64), owner: wp.array(dtype=int), record: wp.array2d(dtype=float),
        feature: wp.array2d(dtype=float), box: wp.array(dtype=wp.vec4i), columns: int, width: int, height: int,
        image: wp.array(dtype=float), gradient: wp.array(dtype=float), slots: wp.array2d(dtype=float),
    ):  # fmt: skip
        """Compute gradients of records and features, one row of `slots` per warp and entry of the tiles' lists before sorting."""
        thread = wp.tid()
        pixel = pixel_of(thread, columns)
        x, y = float(pixel[0]) + 0.5, float(pixel[1]) + 0.5
        tile, part = thread / _PIXELS, (thread % _PIXELS) / _LANES
        at, plane = pixel[1] * width + pixel[0], width * height
        upstream = Row(0.0)
        g_depth, g_opacity, s_total, s_run = float(0.0), float(0.0), float(0.0), float(0.0)
        before = float(0.0)  # outside the image nothing is composited, but the sums over a warp need all of its threads
        if pixel[0] < width and pixel[1] < height:
            before = 1.0
            left = image[(count + 2) * plane + at]
            opaque = left <= _OPAQUE
            scale = wp.where(opaque, 1.0 / (1.0 - left), 1.0)
            for j in range(count):
                up = gradient[j * plane + at]
                upstream[j] = up * scale
                s_total += up * image[j * plane + at]
            up = gradient[count * plane + at]
            g_depth = up * scale
            s_total += up * image[count * plane + at]
            last = gradient[(count + 1) * plane + at]
            g_opacity = wp.where(opaque, -s_total * scale, last)
            s_total = wp.where(opaque, 0.0, s_total + last * (1.0 - left))
        for entry in range(start[tile], start[tile + 1]):
            if any_lane(int(before > _OPAQUE)) == 0:
                break
            place = index[entry]
            g = owner[place]
            rows = box[g]
            sums = Gradient(0.0)
            touched = int(0)
            if before > _OPAQUE and pixel[1] >= rows[1] and pixel[1] <= rows[3]:
                dx, dy = x - record[g, 0], y - record[g, 1]
                c = crossing(record, g, dx, dy)
                if c.rho <= record[g, 10]:
                    touched = 1
                    z = record[g, 8]
                    bell = wp.exp(-0.5 * c.rho)
                    raw = bell * record[g, 9]
                    alpha = wp.min(raw, _ALPHA_MAX)
                    weight = alpha * before
                    q = g_opacity + g_depth * z * wp.where(c.filtered == 1, 1.0, c.iw)
                    for j in range(count):
                        q += upstream[j] * feature[g, j]
                        sums[_GEOMETRY + j] = weight * upstream[j]
                    s_run += weight * q
                    g_alpha = before * q - (s_total - s_run) / (1.0 - alpha)
                    if raw >= _ALPHA_MAX:
                        g_alpha = 0.0
                    before -= weight
                    g_rho = -0.5 * g_alpha * alpha
                    gt = weight * g_depth
                    sums[9] = g_alpha * bell
                    if c.filtered == 1:
                        sums[8] = gt
                        sums[0] = -2.0 * _LOW_PASS * g_rho * dx
                        sums[1] = -2.0 * _LOW_PASS * g_rho * dy
                    else:
                        gu, gv = 2.0 * g_rho * c.iw * c.u, 2.0 * g_rho * c.iw * c.v
                        gw = -(gt * c.iw * c.iw * z + gu * c.u + gv * c.v)
                        sums[8] = gt * c.iw
                        sums[0] = -(gu * record[g, 2] + gv * record[g, 4] + gw * record[g, 6])
                        sums[1] = -(gu * record[g, 3] + gv * record[g, 5] + gw * record[g, 7])
                        sums[2] = gu * dx
                        sums[3] = gu * dy
                        sums[4] = gv * dx
                        sums[5] = gv * dy
                        sums[6] = gw * dx
                        sums[7] = gw * dy
            if any_lane(touched) == 1:
                row = int(place) * _PARTS + part
                for j in range(_GEOMETRY + count):
                    total = lane_sum(sums[j])
                    if leads() == 1:
                        slots[row, j] += total

    return composite, composite_backward
