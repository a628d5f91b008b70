# SPDX-License-Identifier: GPL-3.0-or-later
"""Differentiable rasteriser of 2D Gaussians: public interface over the numba (CPU) and Warp (GPU) kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..machine.backend import by_warp
from ..machine.thread_pool import balanced_ranges, even_ranges, run_ranges, thread_count
from ..scene.camera import Camera
from .constants import NEAR, SPLAT_GRADIENTS, SPLAT_RECORD, TILE
from .cpu.binning import bin_tiles, depth_order
from .cpu.projection import project_backward_range, project_range
from .cpu.raster import rasterize_backward_range, rasterize_range
from .cpu.subpixels import pool_range, spread_range

COLOUR, NORMAL, EXTRA = slice(0, 3), slice(3, 6), 6  # channels of the image; depth and opacity follow the extras
MIN_GAUSSIANS = 8  # lanes of one vector; fewer Gaussians are padded
_TRANSPARENT_LOGIT = -100.0


@dataclass
class ScreenStatistics:
    """Per-Gaussian statistics of one image, used by density control.

    Attributes:
        radius: (N,) half the longer side of the pixel box, in pixels; 0 where culled.
        gradient: (N,) |d loss / d projected centre| per pixel of shift, filled by the backward pass.
        subpixels: rays along each side of a pixel.
    """

    radius: torch.Tensor
    gradient: torch.Tensor | None = None
    subpixels: int = 1


def camera_numbers(camera: Camera, near: float) -> np.ndarray:
    """Return a camera as the kernels read it.

    Args:
        camera: the camera, OpenCV axes.
        near: depth of the near plane, scene units.

    Returns:
        (19,) float32: row-major world-to-camera rotation (9), fx fy cx cy, centre (3), width, height, near depth.
    """
    rotation = camera.world_to_cv[:3, :3].reshape(-1)
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    return np.array([*rotation, *intrinsics, *camera.centre, camera.width, camera.height, near], np.float32)


def _flat(tensor: torch.Tensor) -> np.ndarray:
    """Return the values of a tensor as a contiguous 1-D array, without its autograd history."""
    return tensor.detach().contiguous().view(-1).numpy()


class _Rasterize(torch.autograd.Function):
    """Autograd function of the CPU (numba) backend."""

    @staticmethod
    def forward(ctx, position, quaternion, log_scale, opacity, sh, extra, cam, coefficients, statistics):
        n, extras = position.shape[1], extra.shape[0]
        arrays = [_flat(t) for t in (position, quaternion, log_scale, opacity, sh, extra)]
        record = np.empty((n, SPLAT_RECORD), np.float32)
        feature = np.empty((n, 6 + extras), np.float32)
        box = np.empty((n, 4), np.int32)
        depth = np.empty(n, np.float32)
        blocks = even_ranges(-(-n // 8), thread_count())
        run_ranges(project_range, blocks, *arrays, coefficients, cam, n, record, feature, box, depth)
        width, height = int(cam[16]), int(cam[17])
        columns, rows = -(-width // TILE), -(-height // TILE)
        start, entries = bin_tiles(depth_order(depth, box), box, columns, rows)
        stride, plane = columns * TILE, rows * TILE * columns * TILE
        tiles = balanced_ranges(np.diff(start) + 1, thread_count())
        flat = np.empty((9 + extras) * plane, np.float32)
        hits = (np.empty_like(entries), np.empty(len(entries), np.uint8), np.empty(columns * rows, np.int32))
        run_ranges(rasterize_range, tiles, start, entries, record, feature, box, columns, flat, stride, plane, *hits)
        subpixels = statistics.subpixels
        image = torch.empty(8 + extras, height // subpixels, width // subpixels)
        lines = even_ranges(image.shape[1], thread_count())
        run_ranges(pool_range, lines, flat, stride, plane, subpixels, image.numpy())
        ctx.arrays, ctx.cam, ctx.coefficients, ctx.statistics = arrays, cam, coefficients, statistics
        ctx.lists = (start, hits, record, feature, columns, flat)
        ctx.layout = (stride, plane, blocks)
        ctx.shapes = [t.shape for t in (position, quaternion, log_scale, opacity, sh, extra)]
        statistics.radius = torch.from_numpy(np.maximum(box[:, 2] - box[:, 0], box[:, 3] - box[:, 1]) + 1).clamp_min(0)
        return image

    @staticmethod
    def backward(ctx, gradient):
        stride, plane, blocks = ctx.layout
        start, hits, record, feature, columns, flat = ctx.lists
        n, subpixels = len(record), ctx.statistics.subpixels
        fine = np.empty(len(gradient) * plane, np.float32)
        lines = even_ranges(-(-plane // stride // subpixels), thread_count())
        run_ranges(spread_range, lines, gradient.contiguous().numpy(), subpixels, stride, plane, fine)
        tiles = balanced_ranges(hits[2] + 1, thread_count())
        slots = np.empty((len(tiles), n, -(-(SPLAT_GRADIENTS + feature.shape[1]) // 8) * 8), np.float32)
        touched = np.zeros(slots.shape[:2], np.uint8)
        image = (flat, fine, stride, plane, slots, touched)
        run_ranges(rasterize_backward_range, tiles, start, *hits, record, feature, columns, *image, numbered=True)
        gradients = [torch.empty(shape) for shape in ctx.shapes]
        gradients[4][ctx.coefficients :] = 0.0  # the kernel does not write coefficients beyond the degree
        screen = torch.empty(n)
        outputs = [g.view(-1).numpy() for g in gradients]
        run_ranges(project_backward_range, blocks, *ctx.arrays[:5], ctx.coefficients, ctx.cam, n, slots, touched, *outputs, screen.numpy())
        ctx.statistics.gradient = screen[: len(ctx.statistics.radius)] * subpixels
        return *gradients, None, None, None


def rasterize(
    position: torch.Tensor,
    quaternion: torch.Tensor,
    log_scale: torch.Tensor,
    opacity: torch.Tensor,
    sh: torch.Tensor,
    extra: torch.Tensor,
    camera: Camera,
    scene_radius: float,
    degree: int = 3,
    subpixels: int = 1,
) -> tuple[torch.Tensor, ScreenStatistics]:
    """Composite 2D Gaussians front to back in the order of their centres' depths (2DGS, Huang 2024).

    Args:
        position: (3, N) centres, world.
        quaternion: (4, N) w x y z of any length.
        log_scale: (2, N) logarithms of the two scales.
        opacity: (N,) logits.
        sh: (K, 3, N) SH coefficients, K >= (degree + 1)^2; colour = max(0.5 + sum, 0). Those beyond the degree get no gradient.
        extra: (E, N) further channels, E >= 0.
        camera: camera of the image, H x W pixels.
        scene_radius: radius of the scene, world units; it sets the near plane.
        degree: SH degree in use, 0..3.
        subpixels: a pixel is the mean over so many rays along each side, which smooths outlines; 1 is one ray through its centre.

    Returns:
        Image (8 + E, H, W) and the statistics of density control. The channels are sums over splats of weight x (colour 3, world normal 3,
        extra E, planar depth 1), not divided by opacity, and last the opacity itself. Normals of splats that are seen from behind are
        flipped. Nearly opaque rays count as opaque: their opacity is 1 and their sums are means.
    """
    n, parameters = position.shape[1], (position, quaternion, log_scale, opacity, sh, extra)
    if n < MIN_GAUSSIANS:
        parameters = tuple(_padded(p) for p in parameters)
    statistics = ScreenStatistics(torch.zeros(n, device=position.device), subpixels=subpixels)
    finer = camera.resized(camera.width * subpixels, camera.height * subpixels)
    cam = camera_numbers(finer, NEAR * scene_radius)
    image = _autograd_function(position).apply(*parameters, cam, (degree + 1) ** 2, statistics)
    statistics.radius = statistics.radius[:n] / subpixels
    if subpixels > 1 and by_warp(position):
        image = torch.nn.functional.avg_pool2d(image[None], subpixels)[0]
    return image, statistics


def _autograd_function(tensor: torch.Tensor) -> type[torch.autograd.Function]:
    """Return the autograd function of the backend that works on a tensor."""
    if not by_warp(tensor):
        return _Rasterize
    from .warp.rasterize import Rasterize  # Warp is an optional dependency

    return Rasterize


def _padded(parameter: torch.Tensor) -> torch.Tensor:
    """Append fully transparent Gaussians to a parameter (..., N), N < MIN_GAUSSIANS, to fill one vector."""
    missing = parameter.new_full((*parameter.shape[:-1], MIN_GAUSSIANS - parameter.shape[-1]), _TRANSPARENT_LOGIT)
    return torch.cat([parameter, missing], -1)
