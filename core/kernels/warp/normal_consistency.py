# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal consistency with its gradient on the GPU, a thread per pixel; formulas as in core/kernels/cpu/normal_consistency.py."""

import torch
import warp as wp

from ..constants import DEPTH_FLOOR
from .runtime import launch

_FLOOR = wp.constant(DEPTH_FLOOR)


@wp.func
def point(image: wp.array3d(dtype=float), rays: wp.array3d(dtype=float), y: int, x: int) -> wp.vec3:
    """Return the point of a pixel, its ray times the sum of depths divided by opacity."""
    last = image.shape[0] - 1
    return wp.vec3(rays[0, y, x], rays[1, y, x], rays[2, y, x]) * (image[last - 1, y, x] / wp.max(image[last, y, x], _FLOOR))


@wp.kernel
def disagree(
    image: wp.array3d(dtype=float), rays: wp.array3d(dtype=float), rotation: wp.array(dtype=wp.mat33), inverse_edge: float, weight: float,
    cost: wp.array2d(dtype=float), gradient: wp.array3d(dtype=float), slopes: wp.array2d(dtype=wp.vec3),
):  # fmt: skip
    """Compute the cost of each pixel, (H, W), and its gradients; all are 0 at the image's border.

    inverse_edge: 1 / edge. weight: of a pixel in the sum. Channels 3..6 of `gradient` (C, H, W) receive the gradient of the splatted
    normal, `slopes` (2 H, W) those of the central differences of points along x, then along y.
    """
    y, x = wp.tid()
    height, width = image.shape[1], image.shape[2]
    by_x, by_y, by_normal = wp.vec3(0.0), wp.vec3(0.0), wp.vec3(0.0)
    value = float(0.0)
    if x > 0 and y > 0 and x < width - 1 and y < height - 1:
        dx = point(image, rays, y, x + 1) - point(image, rays, y, x - 1)
        dy = point(image, rays, y + 1, x) - point(image, rays, y - 1, x)
        c = wp.cross(dy, dx)
        inverse = 1.0 / wp.sqrt(wp.max(wp.dot(c, c), 1.0e-20))
        n = c * inverse
        turn = rotation[0]
        s = turn * wp.vec3(image[3, y, x], image[4, y, x], image[5, y, x])
        agreement = wp.dot(s, n)
        disagreement = image[image.shape[0] - 1, y, x] - agreement
        damping = 1.0 / (1.0 + wp.max(disagreement, 0.0) * inverse_edge)
        value = weight * disagreement * damping
        slope = weight * damping * damping
        by_normal = wp.transpose(turn) * n * -slope
        g = (s - n * agreement) * (-slope * inverse)  # by c: the part of s across n, divided by |c|
        by_x = wp.cross(g, dy)
        by_y = wp.cross(dx, g)
    cost[y, x] = value
    for j in range(3):
        gradient[3 + j, y, x] = by_normal[j]
    slopes[y, x] = by_x
    slopes[height + y, x] = by_y


@wp.kernel
def gather_depth(
    image: wp.array3d(dtype=float), rays: wp.array3d(dtype=float), slopes: wp.array2d(dtype=wp.vec3), gradient: wp.array3d(dtype=float)
):
    """Write the gradients of depth sums and opacity from those of the differences of points, and 0 for colours and further channels."""
    y, x = wp.tid()
    last, height, width = image.shape[0] - 1, image.shape[1], image.shape[2]
    total = wp.vec3(0.0)
    if x > 0:
        total += slopes[y, x - 1]
    if x < width - 1:
        total -= slopes[y, x + 1]
    if y > 0:
        total += slopes[height + y - 1, x]
    if y < height - 1:
        total -= slopes[height + y + 1, x]
    g = wp.dot(wp.vec3(rays[0, y, x], rays[1, y, x], rays[2, y, x]), total)
    alpha = image[last, y, x]
    bounded = wp.max(alpha, _FLOOR)
    for j in range(3):
        gradient[j, y, x] = 0.0
    for j in range(6, last - 1):
        gradient[j, y, x] = 0.0
    gradient[last - 1, y, x] = g / bounded
    gradient[last, y, x] = wp.where(alpha > _FLOOR, -g * image[last - 1, y, x] / (bounded * bounded), 0.0)


def consistency_gradient(
    image: torch.Tensor, rays: torch.Tensor, rotation: torch.Tensor, edge: float, factor: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute `normal_consistency` times a factor and its gradient.

    Args:
        image: (C, H, W) float32 sums of the rasteriser, without autograd history.
        rays: (3, H, W) camera rays with z = 1.
        rotation: (3, 3) world to camera.
        edge: see `normal_consistency`.
        factor: of cost and gradient.

    Returns:
        The cost of each pixel (H, W), whose sum is the loss, and its gradient by the image (C, H, W).
    """
    _, height, width = image.shape
    cost, gradient, slopes = image.new_empty(height, width), torch.empty_like(image), image.new_empty(2 * height, width, 3)
    x, lines = image.contiguous(), rays.contiguous()
    launch(disagree, (height, width), x, lines, rotation.contiguous(), 1 / edge, factor / (height * width), cost, gradient, slopes)
    launch(gather_depth, (height, width), x, lines, slopes, gradient)
    return cost, gradient


class NormalConsistency(torch.autograd.Function):
    """Autograd function of core/kernels/normal_consistency.py on the GPU; the forward pass computes the gradient too."""

    @staticmethod
    def forward(ctx, image, rays, rotation, edge):
        """Compute the loss.

        Args:
            ctx: autograd context.
            image: (C, H, W) sums of the rasteriser.
            rays: (3, H, W) camera rays with z = 1.
            rotation: (3, 3) world to camera.
            edge: see `normal_consistency`.

        Returns:
            Scalar loss.
        """
        cost, gradient = consistency_gradient(image.detach().contiguous(), rays, rotation, edge, 1.0)
        ctx.save_for_backward(gradient)
        return cost.sum()

    @staticmethod
    def backward(ctx, upstream):
        """Return the gradient (C, H, W) of the image from that of the loss."""
        return upstream * ctx.saved_tensors[0], None, None, None
