# SPDX-License-Identifier: GPL-3.0-or-later
"""The one face of the rasteriser: Gaussians' parameters to images, differentiable, whatever backend does the work."""

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

COLOUR, NORMAL, EXTRA = slice(0, 3), slice(3, 6), 6  # feature channels; depth and opacity follow the extras
MIN_GAUSSIANS = 8  # one vector
_NOTHING = -100.0  # as an opacity's logit


@dataclass
class ScreenStatistics:
    """What density control wants to know of one image.

    Attributes:
        gradient: (N,) |d loss / d projected centre| per pixel of shift, filled by the backward pass.
        radius: (N,) half the longer side of the pixel box; 0 where culled.
    """

    radius: torch.Tensor
    gradient: torch.Tensor | None = None


def camera_numbers(camera: Camera, near: float) -> np.ndarray:
    """The kernels' camera: rotation (9), fx fy cx cy, centre (3), width, height, near depth; float32."""
    rotation = camera.world_to_cv[:3, :3].reshape(-1)
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    return np.array([*rotation, *intrinsics, *camera.centre, camera.width, camera.height, near], np.float32)


def _flat(tensor: torch.Tensor) -> np.ndarray:
    return tensor.detach().contiguous().view(-1).numpy()


class _Rasterize(torch.autograd.Function):
    """CPU backend."""

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
        image = torch.empty(9 + extras, rows * TILE, columns * TILE)
        stride, plane = columns * TILE, rows * TILE * columns * TILE
        tiles = balanced_ranges(np.diff(start) + 1, thread_count())
        flat = image.view(-1).numpy()
        run_ranges(rasterize_range, tiles, start, entries, record, feature, box, columns, flat, stride, plane)
        ctx.arrays, ctx.cam, ctx.coefficients, ctx.statistics = arrays, cam, coefficients, statistics
        ctx.lists = (start, entries, record, feature, box, columns, flat)
        ctx.layout = (stride, plane, tiles, blocks)
        ctx.shapes = [t.shape for t in (position, quaternion, log_scale, opacity, sh, extra)]
        statistics.radius = torch.from_numpy((box[:, 2:] - box[:, :2]).max(1) + 1).clamp_min(0)
        return image[:-1, :height, :width]

    @staticmethod
    def backward(ctx, gradient):
        stride, plane, tiles, blocks = ctx.layout
        start, entries, record, feature, box, columns, flat = ctx.lists
        n, channels = len(record), feature.shape[1] + 2
        padded = torch.zeros(channels, plane // stride, stride)
        padded[:, : gradient.shape[1], : gradient.shape[2]] = gradient
        slots = np.zeros((len(tiles), n, SPLAT_GRADIENTS + feature.shape[1]), np.float32)
        image = (flat, padded.view(-1).numpy(), stride, plane, slots)
        run_ranges(rasterize_backward_range, tiles, start, entries, record, feature, box, columns, *image, numbered=True)
        gradients = [torch.empty(shape) for shape in ctx.shapes]
        gradients[4][ctx.coefficients :] = 0.0  # SH coefficients that the degree leaves out: the kernel does not write them
        screen = torch.empty(n)
        outputs = [g.view(-1).numpy() for g in gradients]
        run_ranges(project_backward_range, blocks, *ctx.arrays[:5], ctx.coefficients, ctx.cam, n, slots, *outputs, screen.numpy())
        ctx.statistics.gradient = screen[: len(ctx.statistics.radius)]
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
) -> tuple[torch.Tensor, ScreenStatistics]:
    """Composite 2D Gaussians front to back by the depth of their centres (2DGS).

    Args:
        position: (3, N) world; quaternion: (4, N) w x y z, any length; log_scale: (2, N); opacity: (N,) logits.
        sh: (K, 3, N) radiance, colour = max(0.5 + sum, 0), K >= (degree + 1)^2 (those beyond get no gradient).
        extra: (E, N) further channels, E >= 0.
        camera: the image's camera. scene_radius: sets the near plane. degree: SH degree in use, 0..3.

    Returns:
        (8 + E, H, W) sums over splats of weight x (colour 3, world normal turned to the camera 3, extra E, planar depth 1),
        not divided by opacity, and opacity itself last (nearly opaque counts as opaque: there the sums are means); and the
        statistics of density control.
    """
    n, parameters = position.shape[1], (position, quaternion, log_scale, opacity, sh, extra)
    if n < MIN_GAUSSIANS:
        parameters = tuple(_filled(p) for p in parameters)
    statistics = ScreenStatistics(torch.zeros(n, device=position.device))
    cam = camera_numbers(camera, NEAR * scene_radius)
    image = _function(position).apply(*parameters, cam, (degree + 1) ** 2, statistics)
    statistics.radius = statistics.radius[:n]
    return image, statistics


def _function(tensor: torch.Tensor) -> type[torch.autograd.Function]:
    if not by_warp(tensor):
        return _Rasterize
    from .warp.rasterize import Rasterize  # an option, not installed everywhere

    return Rasterize


def _filled(parameter: torch.Tensor) -> torch.Tensor:
    """A parameter (..., N) with Gaussians added that have no opacity, to make one vector."""
    missing = parameter.new_full((*parameter.shape[:-1], MIN_GAUSSIANS - parameter.shape[-1]), _NOTHING)
    return torch.cat([parameter, missing], -1)
