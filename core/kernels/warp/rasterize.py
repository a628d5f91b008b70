# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasteriser on the GPU, wrapped as an autograd function: tile lists without waiting for the host, images, and gradients."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
import warp as wp

from ..constants import SPLAT_GRADIENTS, SPLAT_RECORD, TILE
from . import splats
from .raster import PARTS, PIXELS, kernels
from .runtime import launch

SPARE = 2.0  # capacity over the longest lists so far; from step to step of an optimisation images change slowly
_LAST = torch.iinfo(torch.int64).max


class Room:
    """Capacity of the tile lists of one image size, chosen so that no optimisation step waits for the number of entries.

    The number is read two calls later, when it has long been computed. Without gradients the host waits for it.
    """

    def __init__(self) -> None:
        self._entries = 0
        self._pending: list[tuple[torch.Tensor, torch.cuda.Event | None]] = []
        self.overflowed = 0  # images that lacked some of their splats for want of capacity

    def entries(self, total: torch.Tensor, exact: bool) -> int:
        """Return the capacity to allocate, in entries.

        Args:
            total: (1,) or scalar, number of entries that the image needs.
            exact: wait for the number and return exactly that.

        Returns:
            Number of entries.
        """
        if exact or not self._entries:
            self._entries = max(self._entries, int(SPARE * int(total)) + PIXELS)
            return int(total) if exact else self._entries
        self._pending.append(_on_its_way(total))
        if len(self._pending) > 2:
            number, arrived = self._pending.pop(0)
            if arrived is not None:
                arrived.synchronize()
            self.overflowed += int(number) > self._entries
            self._entries = max(self._entries, int(SPARE * int(number)) + PIXELS)
        return self._entries


def _on_its_way(total: torch.Tensor) -> tuple[torch.Tensor, torch.cuda.Event | None]:
    """Start copying a number to the host; return the copy and the event that marks its arrival (None on the CPU)."""
    if not total.is_cuda:
        return total, None
    number = torch.empty(total.shape, dtype=total.dtype, pin_memory=True)
    number.copy_(total, non_blocking=True)
    arrived = torch.cuda.Event()
    arrived.record()
    return number, arrived


ROOMS: dict[tuple[int, int, int], Room] = {}  # by number of Gaussians, width and height


@lru_cache(4096)
def _pinhole(cam: bytes) -> splats.Pinhole:
    """Return a camera, the bytes of `camera_numbers`, as a Warp struct."""
    numbers, pinhole = np.frombuffer(cam, np.float32), splats.Pinhole()
    pinhole.rotation = wp.mat33(*map(float, numbers[:9]))
    pinhole.focal, pinhole.middle = wp.vec2(*map(float, numbers[9:11])), wp.vec2(*map(float, numbers[11:13]))
    pinhole.eye = wp.vec3(*map(float, numbers[13:16]))
    pinhole.width, pinhole.height, pinhole.near = int(numbers[16]), int(numbers[17]), float(numbers[18])
    return pinhole


@lru_cache(16)
def _edges(count: int, device: torch.device) -> torch.Tensor:
    """Return the least sort key of each tile, (count,) int64."""
    return torch.arange(count, device=device) << 32


class Rasterize(torch.autograd.Function):
    """Autograd function of core/kernels/rasterize.py on the GPU."""

    @staticmethod
    def forward(ctx, position, quaternion, log_scale, opacity, sh, extra, cam, coefficients, statistics):
        """Composite Gaussians into an image.

        Args:
            ctx: autograd context.
            position: (3, N) centres, world.
            quaternion: (4, N) w x y z.
            log_scale: (2, N) logarithms of the scales.
            opacity: (N,) logits.
            sh: (K, 3, N) SH coefficients.
            extra: (E, N) further channels.
            cam: (19,) camera, from `camera_numbers`.
            coefficients: number of SH coefficients in use.
            statistics: receives the statistics of density control.

        Returns:
            (8 + E, H, W) image.
        """
        device, n, extras = position.device, position.shape[1], extra.shape[0]
        parameters = [p.detach().contiguous() for p in (position, quaternion, log_scale, opacity, sh, extra)]
        pinhole, width, height = _pinhole(cam.tobytes()), int(cam[16]), int(cam[17])
        record, feature = torch.empty(n, SPLAT_RECORD, device=device), torch.empty(n, 6 + extras, device=device)
        box, tiles = torch.empty(n, 4, dtype=torch.int32, device=device), torch.empty(n, dtype=torch.int64, device=device)
        statistics.radius = torch.empty(n, device=device)
        launch(splats.project, n, *parameters, coefficients, extras, pinhole, n, record, feature, box, tiles, statistics.radius)
        end = torch.cumsum(tiles, 0)
        list_capacity = ROOMS.setdefault((n, width, height), Room())
        capacity = list_capacity.entries(end[-1], not any(ctx.needs_input_grad))
        columns, rows = -(-width // TILE), -(-height // TILE)
        key = torch.full((capacity,), _LAST, device=device)
        owner = torch.empty(capacity, dtype=torch.int32, device=device)
        launch(splats.emit, n, box, record, end, tiles, columns, capacity, key, owner)
        key, index = torch.sort(key, stable=True)  # stable: at equal depth the Gaussian of lower index comes first
        start = torch.searchsorted(key, _edges(columns * rows + 1, device), out_int32=True)
        image = torch.empty(9 + extras, height, width, device=device)
        lists = (start, index, owner, record, feature, box, columns, width, height)
        launch(kernels(6 + extras)[0], columns * rows * PIXELS, *lists, image)
        ctx.parameters, ctx.pinhole, ctx.coefficients, ctx.statistics = parameters, pinhole, coefficients, statistics
        ctx.lists, ctx.order, ctx.image = lists, (end, tiles, capacity), image
        return image[:-1]

    @staticmethod
    def backward(ctx, gradient):
        """Return the gradients of the parameters from that of the image, (8 + E, H, W)."""
        start, _, _, record, feature, *_ = ctx.lists
        (end, tiles, capacity), (n, features), device = ctx.order, feature.shape, record.device
        slots = torch.zeros(capacity * PARTS, SPLAT_GRADIENTS + features, device=device)
        threads = (len(start) - 1) * PIXELS
        launch(kernels(features)[1], threads, *ctx.lists, ctx.image, gradient.contiguous(), slots)
        sums = torch.empty(n, SPLAT_GRADIENTS + features, device=device)
        launch(splats.sum_slots, sums.shape, slots, end, tiles, capacity, PARTS, sums)
        gradients = [torch.empty_like(p) for p in ctx.parameters]
        gradients[4][ctx.coefficients :] = 0.0
        screen = torch.empty(n, device=device)
        arrays = (*ctx.parameters[:5], ctx.coefficients, features - 6, ctx.pinhole, n, sums)
        launch(splats.project_backward, n, *arrays, *gradients, screen)
        ctx.statistics.gradient = screen[: len(ctx.statistics.radius)] * ctx.statistics.subpixels
        return *gradients, None, None, None
