# SPDX-License-Identifier: GPL-3.0-or-later
"""L1 + D-SSIM with its gradient on the GPU, in four passes; formulas as in core/kernels/photometric.py."""

import torch
import warp as wp

from ..constants import SSIM_C1, SSIM_C2, SSIM_RADIUS, SSIM_TAPS
from .runtime import launch

_RADIUS = wp.constant(SSIM_RADIUS)
_C1, _C2 = wp.constant(float(SSIM_C1)), wp.constant(float(SSIM_C2))


@wp.func
def at(values: wp.array(dtype=float), plane: int, row: int, column: int, height: int, width: int) -> float:
    """Return a pixel of a plane, 0 outside."""
    if row < 0 or row >= height or column < 0 or column >= width:
        return 0.0
    return values[(plane * height + row) * width + column]


@wp.kernel
def across(
    x: wp.array(dtype=float), y: wp.array(dtype=float), taps: wp.array(dtype=float), height: int, width: int, planes: int,
    blurred: wp.array(dtype=float),
):  # fmt: skip
    """Blur x, y, xx, yy, xy horizontally, (5, C, H, W) flat."""
    plane, row, column = wp.tid()
    mx, my, xx, yy, xy = float(0.0), float(0.0), float(0.0), float(0.0), float(0.0)
    for k in range(-_RADIUS, _RADIUS + 1):
        a, b = at(x, plane, row, column + k, height, width), at(y, plane, row, column + k, height, width)
        tap = taps[k + _RADIUS]
        mx += tap * a
        my += tap * b
        xx += tap * a * a
        yy += tap * b * b
        xy += tap * a * b
    here, size = (plane * height + row) * width + column, planes * height * width
    blurred[here] = mx
    blurred[size + here] = my
    blurred[2 * size + here] = xx
    blurred[3 * size + here] = yy
    blurred[4 * size + here] = xy


@wp.kernel
def compare(
    blurred: wp.array(dtype=float), taps: wp.array(dtype=float), height: int, width: int, planes: int, similarity: wp.array(dtype=float),
    slopes: wp.array(dtype=float),
):  # fmt: skip
    """Compute the SSIM of each pixel, (C, H, W), and its derivatives by the means of x, xx and xy, (3, C, H, W)."""
    plane, row, column = wp.tid()
    mx, my, xx, yy, xy = float(0.0), float(0.0), float(0.0), float(0.0), float(0.0)
    for k in range(-_RADIUS, _RADIUS + 1):
        tap = taps[k + _RADIUS]
        mx += tap * at(blurred, plane, row + k, column, height, width)
        my += tap * at(blurred, planes + plane, row + k, column, height, width)
        xx += tap * at(blurred, 2 * planes + plane, row + k, column, height, width)
        yy += tap * at(blurred, 3 * planes + plane, row + k, column, height, width)
        xy += tap * at(blurred, 4 * planes + plane, row + k, column, height, width)
    a1, a2 = 2.0 * mx * my + _C1, 2.0 * (xy - mx * my) + _C2
    b1, b2 = mx * mx + my * my + _C1, wp.max(xx - mx * mx, 0.0) + wp.max(yy - my * my, 0.0) + _C2
    ssim = a1 * a2 / (b1 * b2)
    here, size = (plane * height + row) * width + column, planes * height * width
    similarity[here] = ssim
    slopes[here] = 2.0 * my * (a2 - a1) / (b1 * b2) + 2.0 * mx * ssim * (1.0 / b2 - 1.0 / b1)
    slopes[size + here] = -ssim / b2
    slopes[2 * size + here] = 2.0 * a1 / (b1 * b2)


@wp.kernel
def across_slopes(slopes: wp.array(dtype=float), taps: wp.array(dtype=float), height: int, width: int, blurred: wp.array(dtype=float)):
    """Blur the derivatives horizontally, (3, C, H, W) flat."""
    plane, row, column = wp.tid()
    total = float(0.0)
    for k in range(-_RADIUS, _RADIUS + 1):
        total += taps[k + _RADIUS] * at(slopes, plane, row, column + k, height, width)
    blurred[(plane * height + row) * width + column] = total


@wp.kernel
def gradient_of(
    blurred: wp.array(dtype=float), taps: wp.array(dtype=float), height: int, width: int, planes: int, x: wp.array(dtype=float),
    y: wp.array(dtype=float), l1_weight: float, ssim_weight: float, cost: wp.array(dtype=float), gradient: wp.array(dtype=float),
):  # fmt: skip
    """Compute d loss / d x, (C, H, W), from the horizontally blurred derivatives, and the cost of each value in place of its SSIM."""
    plane, row, column = wp.tid()
    s0, s1, s2 = float(0.0), float(0.0), float(0.0)
    for k in range(-_RADIUS, _RADIUS + 1):
        tap = taps[k + _RADIUS]
        s0 += tap * at(blurred, plane, row + k, column, height, width)
        s1 += tap * at(blurred, planes + plane, row + k, column, height, width)
        s2 += tap * at(blurred, 2 * planes + plane, row + k, column, height, width)
    here = (plane * height + row) * width + column
    a, b = x[here], y[here]
    side = float(0.0)
    if a > b:
        side = 1.0
    if a < b:
        side = -1.0
    gradient[here] = l1_weight * side - ssim_weight * (s0 + 2.0 * a * s1 + b * s2)
    cost[here] = l1_weight * wp.abs(a - b) + ssim_weight * (1.0 - cost[here])


def photometric_gradient(x: torch.Tensor, y: torch.Tensor, ssim_weight: float, factor: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute the photometric loss of x against y times a factor, and its gradient.

    Args:
        x: (C, H, W) float32 image, contiguous, without autograd history.
        y: (C, H, W) float32 image to match, contiguous.
        ssim_weight: weight of D-SSIM, 0..1.
        factor: of cost and gradient.

    Returns:
        The cost of each value, (C, H, W), whose sum is the loss, and its gradient by x, (C, H, W).
    """
    planes, height, width = x.shape
    taps, size = _taps(x.device), (height, width)
    blurred, slopes = x.new_empty(5, *x.shape), x.new_empty(3, *x.shape)
    cost, gradient = torch.empty_like(x), torch.empty_like(x)
    launch(across, x.shape, x, y, taps, *size, planes, blurred)
    launch(compare, x.shape, blurred, taps, *size, planes, cost, slopes)
    launch(across_slopes, (3 * planes, *size), slopes, taps, *size, blurred[:3])
    weights = (factor * (1 - ssim_weight) / x.numel(), factor * ssim_weight / x.numel())
    launch(gradient_of, x.shape, blurred[:3], taps, *size, planes, x, y, *weights, cost, gradient)
    return cost, gradient


class Photometric(torch.autograd.Function):
    """Autograd function of core/kernels/photometric.py on the GPU; it never makes the host wait."""

    @staticmethod
    def forward(ctx, image, target, ssim_weight):
        """Compute the loss and its gradient.

        Args:
            ctx: autograd context.
            image: (C, H, W) float32 rendered image.
            target: (C, H, W) float32 image to match.
            ssim_weight: weight of D-SSIM, 0..1.

        Returns:
            Scalar loss.
        """
        cost, gradient = photometric_gradient(image.detach().contiguous(), target.contiguous(), ssim_weight, 1.0)
        ctx.save_for_backward(gradient)
        return cost.sum()

    @staticmethod
    def backward(ctx, upstream):
        """Return the gradient (C, H, W) of the image from that of the loss."""
        return upstream * ctx.saved_tensors[0], None, None


_taps_by_device: dict[torch.device, torch.Tensor] = {}


def _taps(device: torch.device) -> torch.Tensor:
    """Return the window on a device, cached."""
    if device not in _taps_by_device:
        _taps_by_device[device] = torch.from_numpy(SSIM_TAPS).to(device)
    return _taps_by_device[device]
