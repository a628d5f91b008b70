# SPDX-License-Identifier: GPL-3.0-or-later
"""Deferred split-sum shading and its gradient on the GPU, a thread per pixel; formulas as in core/kernels/cpu/split_sum.py.

The gradient of the light is summed over pixels in integers, which gives the same sum in any order of the threads.
"""

import torch
import warp as wp

from ..constants import DIELECTRIC_F0
from .runtime import launch

_F0, _PI = wp.constant(DIELECTRIC_F0), wp.constant(wp.PI)
_SHORTEST = wp.constant(1e-12)  # lower bound of a normal's length, as in torch.nn.functional.normalize
_POLE2 = wp.constant(1e-12)  # lower bound of a squared sine: exactly at a pole the azimuth has no gradient
_LEAST_COSINE = wp.constant(1e-3)
_UNITS = wp.constant(2.0**36)  # integer units of the largest upstream gradient: 2^27 times that may be summed


@wp.struct
class Mirror:
    """What a pixel reflects: directions in the light's frame, and where to interpolate both tables.

    n, v, mirrored: unit; length: 1 / length of the mean normal. low, share: level and fraction of the way to the next, which changes by
    `slope` per roughness. left, right, top, bottom, fx, fy: texels around the mirrored direction. inside: it is not beyond the last row's
    centre. scale, bias of F0, and their derivatives by n.v and roughness.
    """

    n: wp.vec3
    v: wp.vec3
    mirrored: wp.vec3
    cosine: float
    length: float
    low: int
    share: float
    slope: float
    left: int
    right: int
    top: int
    bottom: int
    fx: float
    fy: float
    inside: int
    scale: float
    bias: float
    by_cosine: wp.vec2
    by_roughness: wp.vec2


@wp.func
def level(m: Mirror, roughness: float, knots: wp.array(dtype=float)) -> Mirror:
    """Set the levels of the stack for a roughness."""
    last = knots.shape[0] - 2
    low = int(0)
    for i in range(1, last + 1):
        low += wp.where(roughness > knots[i], 1, 0)
    m.low = low
    m.slope = 1.0 / (knots[low + 1] - knots[low])
    m.share = (roughness - knots[low]) * m.slope
    if (low == 0 and m.share <= 0.0) or (low == last and m.share >= 1.0):
        m.share = wp.clamp(m.share, 0.0, 1.0)
        m.slope = 0.0
    return m


@wp.func
def corners(m: Mirror, height: int, width: int) -> Mirror:
    """Set the four texels around the mirrored direction; columns wrap, rows are clamped."""
    d = m.mirrored
    x = (0.5 - wp.atan2(d[1], d[0]) / (2.0 * _PI)) * float(width) - 0.5
    y = wp.atan2(wp.sqrt(d[0] * d[0] + d[1] * d[1]), d[2]) / _PI * float(height) - 0.5
    m.inside = int(y > 0.0 and y < float(height) - 1.0)
    y = wp.clamp(y, 0.0, float(height) - 1.0)
    column, row = wp.floor(x), wp.floor(y)
    m.left = (int(column) + width) % width
    m.right = (m.left + 1) % width
    m.top = wp.clamp(int(row), 0, height - 1)
    m.bottom = wp.min(m.top + 1, height - 1)
    m.fx = x - column
    m.fy = y - row
    return m


@wp.func
def albedo_terms(m: Mirror, roughness: float, table: wp.array2d(dtype=wp.vec2)) -> Mirror:
    """Interpolate scale and bias of F0 at n.v and roughness."""
    last = table.shape[0] - 1
    x, y = wp.clamp(m.cosine, _LEAST_COSINE, 1.0) * float(last), wp.clamp(roughness, 0.0, 1.0) * float(last)
    i, j = wp.clamp(int(x), 0, last - 1), wp.clamp(int(y), 0, last - 1)
    fx, fy = x - float(i), y - float(j)
    across, below = table[j, i + 1] - table[j, i], table[j + 1, i + 1] - table[j + 1, i]
    a, b = table[j, i] + across * fx, table[j + 1, i] + below * fx
    pair = a + (b - a) * fy
    m.scale = pair[0]
    m.bias = pair[1]
    m.by_cosine = (across * (1.0 - fy) + below * fy) * float(last)
    m.by_roughness = (b - a) * float(last)
    return m


@wp.func
def mirror_of(
    image: wp.array2d(dtype=float), rays: wp.array2d(dtype=float), rotation: wp.mat33, p: int, inverse: float, height: int, width: int,
    knots: wp.array(dtype=float), table: wp.array2d(dtype=wp.vec2),
) -> Mirror:  # fmt: skip
    """Return what pixel p reflects; inverse: 1 / opacity."""
    m = Mirror()
    mean = wp.vec3(image[3, p], image[4, p], image[5, p]) * inverse
    ray = wp.vec3(rays[0, p], rays[1, p], rays[2, p])
    m.length = 1.0 / wp.max(wp.length(mean), _SHORTEST)
    m.n = rotation * (mean * m.length)
    m.v = rotation * (ray * (-1.0 / wp.max(wp.length(ray), _SHORTEST)))
    m.cosine = wp.dot(m.n, m.v)
    m.mirrored = m.n * (2.0 * m.cosine) - m.v
    roughness = image[9, p] * inverse
    m = level(m, roughness, knots)
    m = corners(m, height, width)
    return albedo_terms(m, roughness, table)


@wp.func
def through(mirrored: wp.array2d(dtype=float), p: int) -> float:
    """Return the fraction of the light that reaches pixel p along its mirrored direction."""
    if mirrored.shape[1] == 0:
        return 1.0
    return mirrored[0, p]


@wp.func
def blocked(mirrored: wp.array2d(dtype=float), p: int) -> wp.vec3:
    """Return the radiance of what blocks the light of pixel p."""
    if mirrored.shape[1] == 0:
        return wp.vec3(0.0)
    return wp.vec3(mirrored[1, p], mirrored[2, p], mirrored[3, p])


@wp.kernel
def shade(
    image: wp.array2d(dtype=float), rays: wp.array2d(dtype=float), rotation: wp.array(dtype=wp.mat33), stack: wp.array3d(dtype=wp.vec3),
    mirrored: wp.array2d(dtype=float), knots: wp.array(dtype=float), table: wp.array2d(dtype=wp.vec2), reflecting: float, floor: float,
    out: wp.array2d(dtype=float),
):  # fmt: skip
    """Write the radiance of each pixel, (3, P); image: (C, P) sums of the rasteriser; without levels in the stack no pixel reflects.

    mirrored: (4, P) transmittance along the mirrored direction and radiance of what blocks it; (4, 0): nothing does.
    """
    p = wp.tid()
    alpha = image[image.shape[0] - 1, p]
    colour = wp.vec3(image[0, p], image[1, p], image[2, p])
    if stack.shape[0] == 0 or not (alpha > reflecting):
        colour = colour / wp.max(alpha, floor)
    else:
        inverse = 1.0 / alpha
        m = mirror_of(image, rays, rotation[0], p, inverse, stack.shape[1], stack.shape[2], knots, table)
        light = wp.vec3(0.0)
        for step in range(2):
            above = stack[m.low + step, m.top, m.left] * (1.0 - m.fx) + stack[m.low + step, m.top, m.right] * m.fx
            below = stack[m.low + step, m.bottom, m.left] * (1.0 - m.fx) + stack[m.low + step, m.bottom, m.right] * m.fx
            light += (above * (1.0 - m.fy) + below * m.fy) * wp.where(step == 0, 1.0 - m.share, m.share)
        light = through(mirrored, p) * light + blocked(mirrored, p)
        metallic = image[10, p] * inverse
        albedo = wp.vec3(image[6, p], image[7, p], image[8, p]) * inverse
        f0 = albedo * metallic + wp.vec3(_F0 * (1.0 - metallic))
        colour = colour * ((1.0 - metallic) * inverse) + wp.cw_mul(light, f0 * m.scale + wp.vec3(m.bias))
    for k in range(3):
        out[k, p] = colour[k]


@wp.func
def normal_gradient(m: Mirror, by_x: float, by_y: float, by_cosine: float) -> wp.vec3:
    """Return the gradient of the unit normal, orthogonal to it, from those of u and v of the mirrored direction and of n.v."""
    d = m.mirrored
    sine2 = wp.max(d[0] * d[0] + d[1] * d[1], _POLE2)
    sine = wp.sqrt(sine2)
    around, down = by_x / (2.0 * _PI * sine2), by_y / _PI
    g = wp.vec3(around * d[1] + down * d[2] * d[0] / sine, down * d[2] * d[1] / sine - around * d[0], -down * sine)
    by_n = g * (2.0 * m.cosine) + m.v * (2.0 * wp.dot(g, m.n) + by_cosine)
    return by_n - m.n * wp.dot(by_n, m.n)


@wp.func
def add_to(sums: wp.array3d(dtype=wp.int64), row: int, column: int, value: wp.vec3):
    """Add a colour, in integer units, to a texel of (L H, W, 3); integers make the sum independent of the order of threads."""
    for k in range(3):
        wp.atomic_add(sums, row, column, k, wp.int64(value[k]))


@wp.kernel
def shade_backward(
    image: wp.array2d(dtype=float), rays: wp.array2d(dtype=float), rotation: wp.array(dtype=wp.mat33), stack: wp.array3d(dtype=wp.vec3),
    mirrored: wp.array2d(dtype=float), knots: wp.array(dtype=float), table: wp.array2d(dtype=wp.vec2), reflecting: float, floor: float,
    upstream: wp.array2d(dtype=float), largest: wp.array(dtype=float), gradient: wp.array2d(dtype=float), sums: wp.array3d(dtype=wp.int64),
):  # fmt: skip
    """Compute the adjoint of `shade`: write `gradient` (C, P), and add that of the stack to `sums` (L H, W, 3).

    largest: of |upstream|, (1,), which sets the unit of the sums. Without rows of the sums the stack's gradient is not computed.
    `mirrored` is constant.
    """
    p = wp.tid()
    last = image.shape[0] - 1
    alpha = image[last, p]
    up = wp.vec3(upstream[0, p], upstream[1, p], upstream[2, p])
    if stack.shape[0] == 0 or not (alpha > reflecting):
        inverse = 1.0 / wp.max(alpha, floor)
        for j in range(3, last):
            gradient[j, p] = 0.0
        dot = up[0] * image[0, p] + up[1] * image[1, p] + up[2] * image[2, p]
        for k in range(3):
            gradient[k, p] = up[k] * inverse
        gradient[last, p] = wp.where(alpha > floor, -dot * inverse * inverse, 0.0)
        return
    inverse = 1.0 / alpha
    height = stack.shape[1]
    m = mirror_of(image, rays, rotation[0], p, inverse, height, stack.shape[2], knots, table)
    metallic = image[10, p] * inverse
    albedo = wp.vec3(image[6, p], image[7, p], image[8, p]) * inverse
    colour = wp.vec3(image[0, p], image[1, p], image[2, p]) * inverse
    f0 = albedo * metallic + wp.vec3(_F0 * (1.0 - metallic))
    a0, b0 = stack[m.low, m.top, m.left], stack[m.low, m.top, m.right]
    c0, d0 = stack[m.low, m.bottom, m.left], stack[m.low, m.bottom, m.right]
    a1, b1 = stack[m.low + 1, m.top, m.left] - a0, stack[m.low + 1, m.top, m.right] - b0
    c1, d1 = stack[m.low + 1, m.bottom, m.left] - c0, stack[m.low + 1, m.bottom, m.right] - d0
    a, b, c, d = a0 + a1 * m.share, b0 + b1 * m.share, c0 + c1 * m.share, d0 + d1 * m.share
    above, below = a + (b - a) * m.fx, c + (d - c) * m.fx
    passing = through(mirrored, p)
    light = (above + (below - above) * m.fy) * passing + blocked(mirrored, p)
    g_light, g_term = wp.cw_mul(up, f0 * m.scale + wp.vec3(m.bias)) * passing, wp.cw_mul(up, light)
    by_x = wp.dot(g_light, (b - a) * (1.0 - m.fy) + (d - c) * m.fy) * float(stack.shape[2])
    by_y = wp.where(m.inside == 1, wp.dot(g_light, below - above) * float(height), 0.0)
    step = (a1 * (1.0 - m.fx) + b1 * m.fx) * (1.0 - m.fy) + (c1 * (1.0 - m.fx) + d1 * m.fx) * m.fy
    g_scale, g_bias = wp.dot(g_term, f0), g_term[0] + g_term[1] + g_term[2]
    g_f0 = g_term * m.scale
    g_metallic = wp.dot(g_f0, albedo - wp.vec3(_F0)) - wp.dot(up, colour)
    g_colour, g_albedo = up * (1.0 - metallic), g_f0 * metallic
    roughness = image[9, p] * inverse
    g_roughness = wp.dot(g_light, step) * m.slope
    if roughness > 0.0 and roughness < 1.0:
        g_roughness += g_scale * m.by_roughness[0] + g_bias * m.by_roughness[1]
    by_cosine = float(0.0)
    if m.cosine >= _LEAST_COSINE and m.cosine <= 1.0:
        by_cosine = g_scale * m.by_cosine[0] + g_bias * m.by_cosine[1]
    g_normal = wp.transpose(rotation[0]) * normal_gradient(m, by_x, by_y, by_cosine) * (m.length * inverse)
    for k in range(3):
        gradient[k, p] = g_colour[k] * inverse
        gradient[3 + k, p] = g_normal[k]
        gradient[6 + k, p] = g_albedo[k] * inverse
    gradient[9, p] = g_roughness * inverse
    gradient[10, p] = g_metallic * inverse
    for j in range(11, last):
        gradient[j, p] = 0.0
    together = wp.dot(g_colour, colour) + wp.dot(g_albedo, albedo) + g_roughness * roughness + g_metallic * metallic
    gradient[last, p] = -together * inverse
    if sums.shape[0] > 0 and largest[0] > 0.0:
        for one in range(2):
            g = g_light * (wp.where(one == 0, 1.0 - m.share, m.share) * (_UNITS / largest[0]))
            top, bottom = (m.low + one) * height + m.top, (m.low + one) * height + m.bottom
            add_to(sums, top, m.left, g * ((1.0 - m.fx) * (1.0 - m.fy)))
            add_to(sums, top, m.right, g * (m.fx * (1.0 - m.fy)))
            add_to(sums, bottom, m.left, g * ((1.0 - m.fx) * m.fy))
            add_to(sums, bottom, m.right, g * (m.fx * m.fy))


@wp.kernel
def in_floats(sums: wp.array(dtype=wp.int64), largest: wp.array(dtype=float), out: wp.array(dtype=float)):
    """Convert the sums of `shade_backward`; they are NaN where the upstream gradient is."""
    i = wp.tid()
    out[i] = float(wp.float64(sums[i]) * wp.float64(largest[0]) / wp.float64(_UNITS))


class Shade(torch.autograd.Function):
    """Autograd function of core/kernels/split_sum.py on the GPU; it never makes the host wait."""

    @staticmethod
    def forward(ctx, image, stack, rays, rotation, mirrored, tables, thresholds):
        """Compute the radiance.

        Args:
            ctx: autograd context.
            image: (C, H, W) sums of the rasteriser.
            stack: (L, h, w, 3) prefiltered light.
            rays: (3, H, W) world directions.
            rotation: (3, 3) world to the frame of the light.
            mirrored: (4, H, W) what mirrored rays meet; (4, 0, 0): nothing.
            tables: roughness of each level (L,), and scale and bias of F0 (T, T, 2).
            thresholds: as those of `shade_pixels`.

        Returns:
            (3, H, W) linear radiance with straight alpha.
        """
        tensors = [t.detach().contiguous() for t in (image.flatten(1), rays.flatten(1), rotation, stack, mirrored.flatten(1), *tables)]
        out = image.new_empty(3, *image.shape[1:])
        ctx.arguments = (*tensors, *thresholds)
        launch(shade, tensors[0].shape[1], *ctx.arguments, out.view(3, -1))
        return out

    @staticmethod
    def backward(ctx, upstream):
        """Return the gradients of the image (C, H, W) and of the stack (L, h, w, 3)."""
        image, stack = ctx.arguments[0], ctx.arguments[3]
        levels, height, width, _ = stack.shape
        up, gradient = upstream.contiguous(), image.new_empty(len(image), *upstream.shape[1:])
        wanted = ctx.needs_input_grad[1]
        sums = torch.zeros((levels * height if wanted else 0, width, 3), dtype=torch.int64, device=image.device)
        largest = torch.linalg.vector_norm(up, torch.inf) if wanted else up.new_empty(1)
        flat = up.view(3, -1), largest, gradient.view(len(image), -1)
        launch(shade_backward, image.shape[1], *ctx.arguments, *flat, sums)
        of_stack = None
        if wanted:
            of_stack = torch.empty_like(stack)
            launch(in_floats, stack.numel(), sums, largest, of_stack)
        return gradient, of_stack, None, None, None, None, None
