# SPDX-License-Identifier: GPL-3.0-or-later
"""Projection of 2D Gaussians to splats, and its adjoint, on the GPU, a thread per Gaussian.

The algebra is that of the CPU's kernels, core/kernels/cpu/frame.py and core/kernels/cpu/projection.py.
"""

import warp as wp

from ..constants import ALPHA_MIN, BEHIND, COSINE_MIN, LOG_SCALE_MIN, LOW_PASS, SPLAT_GRADIENTS, TILE
from .harmonics import Basis, basis, basis_pull, normal_of, quaternion_gradient, tangent_u, tangent_v, unit_quaternion

_SIDE = wp.constant(TILE)
_ALPHA_MIN, _BEHIND, _COSINE_MIN = wp.constant(ALPHA_MIN), wp.constant(BEHIND), wp.constant(COSINE_MIN)
_LOG_SCALE_MIN, _LOW_PASS = wp.constant(LOG_SCALE_MIN), wp.constant(LOW_PASS)
_FEATURES = wp.constant(SPLAT_GRADIENTS)  # first column of the features among a splat's gradients


@wp.struct
class Pinhole:
    """Camera: rotation world to camera (z forward), intrinsics, centre, size of the image, near depth."""

    rotation: wp.mat33
    focal: wp.vec2
    middle: wp.vec2
    eye: wp.vec3
    width: int
    height: int
    near: float


@wp.struct
class Frame:
    """Surfel in camera space: offset from the eye, centre, axes.

    The foreshortening nc is clamped away from 0 (`free`: not clamped); `facing` is 1, or -1 where the surfel is seen from behind.
    """

    offset: wp.vec3
    c: wp.vec3
    tu: wp.vec3
    tv: wp.vec3
    normal: wp.vec3
    world_normal: wp.vec3
    nc: float
    excess: float
    facing: float
    free: int


@wp.func
def frame(position: wp.array(dtype=float), quaternion: wp.array(dtype=float), n: int, i: int, cam: Pinhole) -> Frame:
    """Return surfel i in camera space."""
    f = Frame()
    f.offset = wp.vec3(position[i], position[n + i], position[2 * n + i]) - cam.eye
    f.c = cam.rotation * f.offset
    q = unit_quaternion(wp.vec4(quaternion[i], quaternion[n + i], quaternion[2 * n + i], quaternion[3 * n + i]))
    f.world_normal = normal_of(q)
    f.tu = cam.rotation * tangent_u(q)
    f.tv = cam.rotation * tangent_v(q)
    f.normal = cam.rotation * f.world_normal
    nc = wp.dot(f.normal, f.c)
    side = wp.where(nc > 0.0, 1.0, -1.0)
    distance = wp.sqrt(wp.max(wp.dot(f.c, f.c), cam.near * cam.near))
    f.facing = wp.where(nc > _BEHIND * distance, -1.0, 1.0)
    f.free = int(nc * side > _COSINE_MIN * distance)
    f.nc = wp.where(f.free == 1, nc, side * _COSINE_MIN * distance)
    f.excess = f.nc - nc
    return f


@wp.func
def colour_channel(sh: wp.array(dtype=float), b: Basis, coefficients: int, channel: int, n: int, i: int) -> float:
    """Return one channel of Gaussian i's colour before its clamp."""
    value = float(0.5)
    for j in range(16):
        if j < coefficients:
            value += b[j] * sh[(j * 3 + channel) * n + i]
    return value


@wp.func
def reach(low: float, high: float, limit: int) -> wp.vec2i:
    """Return the first and last pixel inside the image along an axis whose centres lie in low..high."""
    first = wp.max(0.0, wp.ceil(wp.clamp(low, -1.0e9, 1.0e9) - 0.5))
    last = wp.min(float(limit) - 1.0, wp.floor(wp.clamp(high, -1.0e9, 1.0e9) - 0.5))
    return wp.vec2i(int(first), int(last))


@wp.func
def pixels_of(f: Frame, su: float, sv: float, cut: float, centre: wp.vec2, cam: Pinhole) -> wp.vec4i:
    """Return x0 y0 x1 y1 of the pixels that a surfel may cover; x0 > x1 for none."""
    z = f.c[2]
    u, v = f.tu * su, f.tv * sv
    d = cut * (u[2] * u[2] + v[2] * v[2]) - z * z
    if d > -cam.near * cam.near:  # the surfel reaches behind the plane of the camera
        return wp.vec4i(0, 0, cam.width - 1, cam.height - 1)
    pad = wp.sqrt(cut / _LOW_PASS)
    box = wp.vec4i(1, 1, 0, 0)
    limits = wp.vec2i(cam.width, cam.height)
    for axis in range(2):
        c = f.c[axis]
        middle = (cut * (u[axis] * u[2] + v[axis] * v[2]) - c * z) / d
        spread = wp.sqrt(wp.max(0.0, middle * middle - (cut * (u[axis] * u[axis] + v[axis] * v[axis]) - c * c) / d))
        low = wp.min((middle - spread) * cam.focal[axis] + cam.middle[axis], centre[axis] - pad)
        high = wp.max((middle + spread) * cam.focal[axis] + cam.middle[axis], centre[axis] + pad)
        ends = reach(low, high, limits[axis])
        if not (ends[0] <= ends[1]):
            return wp.vec4i(1, 1, 0, 0)
        box[axis] = ends[0]
        box[axis + 2] = ends[1]
    return box


@wp.kernel
def project(
    position: wp.array(dtype=float), quaternion: wp.array(dtype=float), log_scale: wp.array(dtype=float), opacity: wp.array(dtype=float),
    sh: wp.array(dtype=float), extra: wp.array(dtype=float), coefficients: int, extras: int, cam: Pinhole, n: int,
    record: wp.array2d(dtype=float), feature: wp.array2d(dtype=float), box: wp.array(dtype=wp.vec4i), tiles: wp.array(dtype=wp.int64),
    radius: wp.array(dtype=float),
):  # fmt: skip
    """Write records, features and pixel boxes as `project_range` of the CPU does, and (N,) tiles that each splat touches.

    radius: (N,) receives the longer side of the box in pixels, 0 for none.
    """
    i = wp.tid()
    f = frame(position, quaternion, n, i, cam)
    su, sv = wp.exp(wp.max(log_scale[i], _LOG_SCALE_MIN)), wp.exp(wp.max(log_scale[n + i], _LOG_SCALE_MIN))
    front = f.c[2] > cam.near
    z = wp.where(front, f.c[2], 1.0)
    k = z / f.nc
    excess = wp.where(f.free == 1, 0.0, f.excess)
    e, g = wp.cross(f.tv, f.c) + f.tu * excess, wp.cross(f.c, f.tu) + f.tv * excess
    alpha = 1.0 / (1.0 + wp.exp(-opacity[i]))
    centre = wp.vec2(f.c[0] / z * cam.focal[0] + cam.middle[0], f.c[1] / z * cam.focal[1] + cam.middle[1])
    record[i, 0] = centre[0]
    record[i, 1] = centre[1]
    for axis in range(2):
        record[i, 2 + axis] = e[axis] * (k / su) / cam.focal[axis]
        record[i, 4 + axis] = g[axis] * (k / sv) / cam.focal[axis]
        record[i, 6 + axis] = f.normal[axis] * k / cam.focal[axis]
    record[i, 8] = f.c[2]
    record[i, 9] = alpha
    cut = float(0.0)
    pixels = wp.vec4i(1, 1, 0, 0)
    if front and alpha > _ALPHA_MIN:
        cut = 2.0 * wp.log(alpha / _ALPHA_MIN)
        pixels = pixels_of(f, su, sv, cut, centre, cam)
    record[i, 10] = cut
    box[i] = pixels
    count = int(0)
    if pixels[0] <= pixels[2]:
        count = (pixels[2] / _SIDE - pixels[0] / _SIDE + 1) * (pixels[3] / _SIDE - pixels[1] / _SIDE + 1)
    tiles[i] = wp.int64(count)
    radius[i] = wp.where(count > 0, float(wp.max(pixels[2] - pixels[0], pixels[3] - pixels[1]) + 1), 0.0)
    b = basis(f.offset / wp.sqrt(wp.max(wp.dot(f.offset, f.offset), 1.0e-20)), coefficients)
    for channel in range(3):
        feature[i, channel] = wp.max(colour_channel(sh, b, coefficients, channel, n, i), 0.0)
        feature[i, 3 + channel] = f.facing * f.world_normal[channel]
    for j in range(extras):
        feature[i, 6 + j] = extra[j * n + i]


@wp.kernel
def emit(
    box: wp.array(dtype=wp.vec4i), record: wp.array2d(dtype=float), end: wp.array(dtype=wp.int64), tiles: wp.array(dtype=wp.int64),
    columns: int, capacity: wp.int64, key: wp.array(dtype=wp.int64), owner: wp.array(dtype=int),
):  # fmt: skip
    """Write a sort key (tile, depth) and the owner of splat i for each tile it touches, from end[i] - tiles[i] on, up to `capacity`."""
    i = wp.tid()
    at = end[i] - tiles[i]
    b = box[i]
    depth = wp.int64(wp.cast(record[i, 8], wp.uint32))  # the bits of positive floats sort like the floats
    if b[0] > b[2]:
        return
    for ty in range(b[1] / _SIDE, b[3] / _SIDE + 1):
        for tx in range(b[0] / _SIDE, b[2] / _SIDE + 1):
            if at < capacity:
                key[at] = (wp.int64(ty * columns + tx) << wp.int64(32)) | depth
                owner[at] = i
            at += wp.int64(1)


@wp.kernel
def sum_slots(
    slots: wp.array2d(dtype=float), end: wp.array(dtype=wp.int64), tiles: wp.array(dtype=wp.int64), capacity: wp.int64, parts: int,
    sums: wp.array2d(dtype=float),
):  # fmt: skip
    """Sum column j of the gradients of splat i over its tiles, in order, so that the sum is always the same."""
    i, j = wp.tid()
    last = wp.min(end[i], capacity)
    total = float(0.0)
    for part in range(parts):
        at = end[i] - tiles[i]
        while at < last:
            total += slots[int(at) * parts + part, j]
            at += wp.int64(1)
    sums[i, j] = total


@wp.kernel
def project_backward(
    position: wp.array(dtype=float), quaternion: wp.array(dtype=float), log_scale: wp.array(dtype=float), opacity: wp.array(dtype=float),
    sh: wp.array(dtype=float), coefficients: int, extras: int, cam: Pinhole, n: int, sums: wp.array2d(dtype=float),
    g_position: wp.array(dtype=float), g_quaternion: wp.array(dtype=float), g_log_scale: wp.array(dtype=float),
    g_opacity: wp.array(dtype=float), g_sh: wp.array(dtype=float), g_extra: wp.array(dtype=float), screen: wp.array(dtype=float),
):  # fmt: skip
    """Compute the adjoint of `project`: from sums (N, SPLAT_GRADIENTS + F) to gradients of parameters; screen: (N,)."""
    i = wp.tid()
    f = frame(position, quaternion, n, i, cam)
    isu, isv = wp.exp(-wp.max(log_scale[i], _LOG_SCALE_MIN)), wp.exp(-wp.max(log_scale[n + i], _LOG_SCALE_MIN))
    front = f.c[2] > cam.near
    z = wp.where(front, f.c[2], 1.0)
    k, iz = z / f.nc, 1.0 / z
    excess = wp.where(f.free == 1, 0.0, f.excess)
    e, g = wp.cross(f.tv, f.c) + f.tu * excess, wp.cross(f.c, f.tu) + f.tv * excess
    gm = wp.vec2(sums[i, 0], sums[i, 1])
    ga = wp.vec3(sums[i, 2] * isu / cam.focal[0], sums[i, 3] * isu / cam.focal[1], 0.0)
    gb = wp.vec3(sums[i, 4] * isv / cam.focal[0], sums[i, 5] * isv / cam.focal[1], 0.0)
    gc = wp.vec3(sums[i, 6] / cam.focal[0], sums[i, 7] / cam.focal[1], 0.0)
    au, bv = wp.dot(ga, e), wp.dot(gb, g)
    gk = au + bv + wp.dot(gc, f.normal)
    ge, gg = ga * k, gb * k
    gnc = wp.where(f.free == 1, -gk * k / f.nc, 0.0)
    gexcess = wp.where(f.free == 1, 0.0, -(wp.dot(ge, f.tu) + wp.dot(gg, f.tv)))
    gn = gc * k + f.c * (gnc + gexcess)
    g_tv = wp.cross(f.c, ge) + gg * excess
    g_tu = wp.cross(gg, f.c) + ge * excess
    g_c = wp.cross(ge, f.tv) + wp.cross(f.tu, gg) + f.normal * (gnc + gexcess)
    gz = gk / f.nc + sums[i, 8] - (gm[0] * cam.focal[0] * f.c[0] + gm[1] * cam.focal[1] * f.c[1]) * iz * iz
    g_c += wp.vec3(gm[0] * cam.focal[0] * iz, gm[1] * cam.focal[1] * iz, gz)
    back = wp.transpose(cam.rotation)
    g_world = back * g_c
    g_log_scale[i] = -au * k
    g_log_scale[n + i] = -bv * k
    screen[i] = wp.length(gm)
    alpha = 1.0 / (1.0 + wp.exp(-opacity[i]))
    g_opacity[i] = sums[i, 9] * alpha * (1.0 - alpha)
    turned = wp.vec3(sums[i, _FEATURES + 3], sums[i, _FEATURES + 4], sums[i, _FEATURES + 5]) * f.facing
    raw = wp.vec4(quaternion[i], quaternion[n + i], quaternion[2 * n + i], quaternion[3 * n + i])
    gq = quaternion_gradient(raw, back * g_tu, back * g_tv, back * gn + turned)
    for j in range(4):
        g_quaternion[j * n + i] = gq[j]
    inverse = 1.0 / wp.sqrt(wp.max(wp.dot(f.offset, f.offset), 1.0e-20))
    direction = f.offset * inverse
    b = basis(direction, coefficients)
    g_basis = Basis(0.0)
    for channel in range(3):
        shown = colour_channel(sh, b, coefficients, channel, n, i) > 0.0
        gradient = wp.where(shown, sums[i, _FEATURES + channel], 0.0)
        for j in range(16):
            if j < coefficients:
                at = (j * 3 + channel) * n + i
                g_sh[at] = b[j] * gradient
                g_basis[j] += sh[at] * gradient
    gd = basis_pull(direction, coefficients, g_basis)
    g_world += (gd - direction * wp.dot(gd, direction)) * inverse
    for j in range(3):
        g_position[j * n + i] = wp.where(front, g_world[j], 0.0)
    for j in range(extras):
        g_extra[j * n + i] = sums[i, _FEATURES + 6 + j]
