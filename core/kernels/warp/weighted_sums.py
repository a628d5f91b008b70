# SPDX-License-Identifier: GPL-3.0-or-later
"""BRDF-weighted sums over light samples with their gradients on the GPU; formulas as in core/kernels/cpu/reflection.py.

LANES threads to a point sum every LANES-th sample each; their sums are added in a fixed order.
"""

import math

import torch
import warp as wp

from ..constants import FRESNEL, SHORTEST2
from .reflection import Point, fresnel_weight, lobe, point_of
from .runtime import LANES, launch

_LANES, _PI, _SHORTEST2 = wp.constant(LANES), wp.constant(math.pi), wp.constant(SHORTEST2)
_A0, _A1, _A2, _A3, _A4 = (wp.constant((3 + i) * factor) for i, factor in enumerate(FRESNEL))


@wp.struct
class SampleGradient:
    """Gradient of the sums by a sample's light, and by its point: view, normal, n.v and alpha^2."""

    incoming: wp.vec3
    view: wp.vec3
    normal: wp.vec3
    n_v: float
    a2: float


@wp.func
def fresnel_slope(x: float) -> float:
    """Return the derivative of `fresnel_weight`."""
    return x * x * ((((x * _A4 + _A3) * x + _A2) * x + _A1) * x + _A0)


@wp.kernel
def add_up(
    view: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), alpha: wp.array(dtype=float), direction: wp.array2d(dtype=wp.vec3),
    density: wp.array2d(dtype=float), incoming: wp.array2d(dtype=wp.vec3), sums: wp.array3d(dtype=wp.vec3),
):  # fmt: skip
    """Write sums (P, LANES, 3) of incoming light weighted for the diffuse lobe, for F0 and for what Fresnel adds."""
    p, lane = wp.tid()
    count = density.shape[1]
    point = point_of(normal[p], view[p], wp.dot(normal[p], view[p]), alpha[p])
    by_cosine, by_f0, by_fresnel = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0)
    for i in range(lane, count, _LANES):
        d = direction[p, i]
        n_l = wp.dot(point.n, d)
        if n_l > 0.0:
            light = incoming[p, i] * (n_l / (density[p, i] * float(count)))
            parts = lobe(point, d, n_l)
            by_cosine += light
            by_f0 += light * parts[0]
            by_fresnel += light * parts[1]
    sums[p, lane, 0] = by_cosine
    sums[p, lane, 1] = by_f0
    sums[p, lane, 2] = by_fresnel


@wp.func
def sample_gradient(
    point: Point, d: wp.vec3, n_l: float, inverse_density: float, light: wp.vec3, g_cosine: wp.vec3, g_f0: wp.vec3, g_fresnel: wp.vec3
) -> SampleGradient:
    """Return the gradient by one sample with n_l > 0 from those of the three sums; names as in `reflect_backward_range` of the CPU."""
    out, n, a2, n_v, root_v = SampleGradient(), point.n, point.a2, point.n_v, point.root
    h = d + point.v
    length2, n_h = wp.max(wp.dot(h, h), _SHORTEST2), n_l + n_v
    t = h - n * n_h
    sine2 = wp.dot(t, t) / length2
    k, root_l = a2 + sine2 * (1.0 - a2), wp.sqrt(n_l * n_l * (1.0 - a2) + a2)
    distribution, visibility = a2 / (_PI * k * k), 0.5 / (n_l * root_v + n_v * root_l)
    length, weight = wp.sqrt(length2), n_l * inverse_density
    x = wp.max(1.0 - 0.5 * length, 0.0)
    fresnel, value = fresnel_weight(x), distribution * visibility * weight
    out.incoming = g_cosine * weight + g_f0 * (value * (1.0 - fresnel)) + g_fresnel * (value * fresnel)
    d_scaled, d_bias = wp.dot(g_f0, light), wp.dot(g_fresnel, light)
    d_value = d_scaled * (1.0 - fresnel) + d_bias * fresnel
    d_n_l = (wp.dot(g_cosine, light) + d_value * distribution * visibility) * inverse_density
    # visibility = 0.5 / (n_l root_v + n_v root_l)
    d_sum = -2.0 * visibility * visibility * d_value * distribution * weight
    d_n_l += d_sum * (root_v + n_v * n_l * (1.0 - a2) / root_l)
    d_n_v = d_sum * (root_l + n_l * n_v * (1.0 - a2) / root_v)
    d_a2 = 0.5 * d_sum * (n_l * (1.0 - n_v * n_v) / root_v + n_v * (1.0 - n_l * n_l) / root_l)
    # distribution = a2 / (pi k^2), k = a2 + sine2 (1 - a2)
    d_distribution = d_value * visibility * weight
    d_k = -2.0 * distribution / k * d_distribution
    d_a2 += d_distribution * distribution / a2 + d_k * (1.0 - sine2)
    # sine2 = t.t / length2, t = h - n_h n
    d_sine2 = d_k * (1.0 - a2) / length2
    d_length2 = -d_sine2 * sine2 - 0.25 * fresnel_slope(x) * value * (d_bias - d_scaled) / length
    if length2 <= _SHORTEST2:
        d_length2 = 0.0
    d_t = 2.0 * d_sine2
    d_n_h = -d_t * wp.dot(t, n)
    out.view = t * d_t + h * (2.0 * d_length2)
    out.normal = d * (d_n_l + d_n_h) - t * (d_t * n_h)
    out.n_v = d_n_v + d_n_h
    out.a2 = d_a2
    return out


@wp.kernel
def add_up_backward(
    view: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), alpha: wp.array(dtype=float), direction: wp.array2d(dtype=wp.vec3),
    density: wp.array2d(dtype=float), incoming: wp.array2d(dtype=wp.vec3), gradient: wp.array2d(dtype=wp.vec3),
    d_point: wp.array3d(dtype=float), d_incoming: wp.array2d(dtype=wp.vec3),
):  # fmt: skip
    """Compute the adjoint of `add_up` from `gradient` (P, 3) of the sums.

    Writes `d_point` (P, LANES, 7), the gradients of view, normal and alpha, and `d_incoming` (P, N).
    """
    p, lane = wp.tid()
    count = density.shape[1]
    n, v = normal[p], view[p]
    point = point_of(n, v, wp.dot(n, v), alpha[p])
    d_view, d_normal, d_n_v, d_a2 = wp.vec3(0.0, 0.0, 0.0), wp.vec3(0.0, 0.0, 0.0), float(0.0), float(0.0)
    for i in range(lane, count, _LANES):
        d = direction[p, i]
        n_l = wp.dot(n, d)
        if n_l > 0.0:
            each = 1.0 / (density[p, i] * float(count))
            g = sample_gradient(point, d, n_l, each, incoming[p, i], gradient[p, 0], gradient[p, 1], gradient[p, 2])
            d_incoming[p, i] = g.incoming
            d_view += g.view
            d_normal += g.normal
            d_n_v += g.n_v
            d_a2 += g.a2
        else:
            d_incoming[p, i] = wp.vec3(0.0, 0.0, 0.0)
    d_view += n * d_n_v
    d_normal += v * d_n_v
    for axis in range(3):
        d_point[p, lane, axis] = d_view[axis]
        d_point[p, lane, 3 + axis] = d_normal[axis]
    d_point[p, lane, 6] = 2.0 * alpha[p] * d_a2


class WeightedSums(torch.autograd.Function):
    """Autograd function of core/kernels/reflection.py on the GPU."""

    @staticmethod
    def forward(ctx, view, normal, alpha, direction, density, incoming):
        """Return the sums (P, 3, 3); arguments as `weighted_sums` takes them."""
        tensors = [t.detach().contiguous() for t in (view, normal, alpha, direction, density, incoming)]
        ctx.save_for_backward(*tensors)
        sums = view.new_zeros(len(view), LANES, 3, 3)
        if density.numel():
            launch(add_up, sums.shape[:2], *tensors, sums)
        return sums.sum(1)

    @staticmethod
    def backward(ctx, gradient):
        """Return the gradients of view, normal, alpha and incoming light from those of the sums, (P, 3, 3)."""
        tensors = ctx.saved_tensors
        d_point, d_incoming = gradient.new_zeros(len(gradient), LANES, 7), torch.zeros_like(tensors[-1])
        if tensors[4].numel():
            launch(add_up_backward, d_point.shape[:2], *tensors, gradient.contiguous(), d_point, d_incoming)
        d_view, d_normal, d_alpha = d_point.sum(1).split([3, 3, 1], 1)
        return d_view, d_normal, d_alpha[:, 0], None, None, d_incoming
