# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal consistency loss of 2DGS: splatted normals agree with the normals of the depth; differentiable, on the CPU or a GPU."""

from __future__ import annotations

import math

import numpy as np
import torch

from ..machine.backend import by_warp
from ..machine.thread_pool import even_ranges, run_ranges, thread_count
from .constants import DEPTH_FLOOR
from .cpu.normal_consistency import depth_gradient_range, disagreement_range


class _NormalConsistency(torch.autograd.Function):
    """Autograd function of the CPU (numba) backend; the forward pass computes the gradient too."""

    @staticmethod
    def forward(ctx, image, rays, rotation, edge):
        sums, directions, turn = (t.detach().contiguous().numpy() for t in (image, rays, rotation))
        value, gradient = consistency_gradient(sums, directions, turn, edge)
        ctx.save_for_backward(torch.from_numpy(gradient))
        return torch.tensor(value, dtype=image.dtype)

    @staticmethod
    def backward(ctx, upstream):
        return upstream * ctx.saved_tensors[0], None, None, None


def consistency_gradient(image: np.ndarray, rays: np.ndarray, rotation: np.ndarray, edge: float = math.inf) -> tuple[float, np.ndarray]:
    """Compute `normal_consistency` and its gradient by the image, (C, H, W), on the CPU; all arrays are float32."""
    _, height, width = image.shape
    gradient, slopes = np.zeros_like(image), np.zeros((6, height + 2, width + 2), np.float32)
    sums, floor = np.zeros(height), np.float32(DEPTH_FLOOR)
    inner = [(a + 1, b + 1) for a, b in even_ranges(height - 2, thread_count())]
    run_ranges(disagreement_range, inner, image, rays, rotation, floor, np.float32(edge), gradient, slopes, sums)
    run_ranges(depth_gradient_range, even_ranges(height, thread_count()), image, rays, floor, slopes, gradient)
    return sums.sum() / (height * width), gradient


def depth_normals(depth: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    """Compute normals of a depth map by central differences of the back-projected points.

    Args:
        depth: (H, W) planar depth.
        rays: (3, H, W) camera rays with z = 1.

    Returns:
        (3, H-2, W-2) unit normals in camera axes, facing the camera, without the border pixels.
    """
    points = rays * depth
    dx = points[:, 1:-1, 2:] - points[:, 1:-1, :-2]
    dy = points[:, 2:, 1:-1] - points[:, :-2, 1:-1]
    normal = torch.linalg.cross(dy, dx, dim=0)
    return normal * torch.rsqrt(normal.square().sum(0, keepdim=True).clamp_min(1e-20))


def normal_consistency(image: torch.Tensor, rays: torch.Tensor, rotation: torch.Tensor, edge: float = math.inf) -> torch.Tensor:
    """Compute the normal consistency loss of 2DGS (Huang et al. 2024, eq. 14): mean over pixels of alpha (1 - n_splat . n_depth).

    At an edge of the object the depth's normal is a mean of both sides, and the loss would round the edge off or fill the corner. With a
    finite `edge` e, a pixel's disagreement d therefore counts as d / (1 + d / e), so that large ones hardly pull (Geman-McClure).

    Args:
        image: (C, H, W) of `rasterize`: normals in channels 3..6, depth and opacity last; not divided by opacity.
        rays: (3, H, W) camera rays with z = 1.
        rotation: (3, 3) world to camera (OpenCV axes).
        edge: disagreement 1 - n_splat . n_depth that counts half, above 0; infinite: as published.

    Returns:
        Scalar; the outer alpha is detached.
    """
    if image.dtype != torch.float32:
        return normal_consistency_reference(image, rays, rotation, edge)
    if not by_warp(image):
        return _NormalConsistency.apply(image, rays, rotation, edge)
    from .warp.normal_consistency import NormalConsistency  # Warp is an optional dependency

    return NormalConsistency.apply(image, rays, rotation, edge)


def normal_consistency_reference(image: torch.Tensor, rays: torch.Tensor, rotation: torch.Tensor, edge: float = math.inf) -> torch.Tensor:
    """Compute `normal_consistency` in PyTorch operations, for any floating type and device: its reference implementation.

    Args:
        image: (C, H, W) of `rasterize`.
        rays: (3, H, W) camera rays with z = 1.
        rotation: (3, 3) world to camera (OpenCV axes).
        edge: disagreement that counts half.
    """
    alpha = image[-1]
    # Not detached here: sum(w z) / sum(w) must not increase the depth when a splat only grows more opaque.
    surface = depth_normals(image[-2] / alpha.clamp_min(DEPTH_FLOOR), rays)
    splat = torch.einsum("ij,jhw->ihw", rotation, image[3:6, 1:-1, 1:-1])
    weight = alpha.detach()[1:-1, 1:-1]
    disagreement = weight - (splat * surface).sum(0)
    return (disagreement / (1 + disagreement.clamp_min(0) / edge)).sum() / alpha.numel()
