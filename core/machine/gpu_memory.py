# SPDX-License-Identifier: GPL-3.0-or-later
"""GPU memory of a job: estimated before the job starts, and made to fit by keeping the photographs off the GPU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from ..errors import InputError
from ..settings.schema import Settings

MIB = 1 << 20
CONTEXT = 600 * MIB  # of CUDA itself, torch's libraries and warp's kernels
USABLE = 0.9  # fraction of the free memory that a job may plan with: the rest is lost to fragmentation
GAUSSIAN = 4 * 63 * 4  # bytes: 63 parameters, their gradients and Adam's two moments
ENTRIES = 16.0  # of a Gaussian in the tile lists, spare capacity included
ENTRY = 8 + 8 + 4 + 2 * 4 * (10 + 11)  # bytes: key, sorted position, owner, gradients of two warps
PIXEL = 4 * (3 * 20 + 60)  # bytes per pixel of the forward and backward pass: sums, gradients, autograd's saved tensors
PHOTOGRAPH = 4 * (3 + 1 + 3 + 3) + 3  # bytes per pixel of a target: image, alpha, rays twice, saturation
RAY = 400  # bytes per ray of the second stage or of relighting, with its direction, density and sums
RAYS = 1 << 22  # largest number of rays that relighting traces at once
FEWEST = 1 << 14  # smallest number of them


@dataclass(frozen=True)
class Plan:
    """Memory layout of a job on a GPU.

    Attributes:
        needed: approximate bytes that the job needs.
        targets: photographs stay on the GPU; otherwise each is copied there for its step.
    """

    needed: int
    targets: bool


def estimate_gpu_memory(settings: Settings, views: int, width: int, height: int, targets: bool) -> int:
    """Estimate the bytes of GPU memory that the largest step of a job takes.

    Args:
        settings: settings of the job.
        views: number of training views.
        width: of a photograph in pixels.
        height: of a photograph in pixels.
        targets: photographs stay on the GPU.
    """
    pixels = width * height
    first = settings.first.gaussians * int(GAUSSIAN + ENTRIES * ENTRY) + pixels * PIXEL
    second, texels = settings.second, 2 * settings.second.rows**2
    points = second.points * texels * 4 * (4 * 4 + 1) + second.points * second.views * texels * 4 * 6
    solve = max(points, second.pixels * second.samples * RAY) + settings.first.gaussians * GAUSSIAN
    stored = views * pixels * PHOTOGRAPH if targets else 0
    return CONTEXT + stored + max(first, solve, FEWEST * RAY)


def plan(settings: Settings, views: int, width: int, height: int, free: int) -> Plan:
    """Choose the memory layout with which a job fits into the GPU's memory.

    Args:
        settings: settings of the job.
        views: number of training views.
        width: of a photograph in pixels.
        height: of a photograph in pixels.
        free: free bytes of the GPU's memory.

    Raises:
        InputError: if no layout fits.
    """
    needed = 0
    for targets in (True, False):
        needed = estimate_gpu_memory(settings, views, width, height, targets)
        if needed <= USABLE * free:
            return Plan(needed, targets)
    raise InputError(
        "--device cuda",
        f"the job needs about {needed / 2**30:.1f} GiB of the GPU's memory, of which {free / 2**30:.1f} GiB are free",
        "lower data.resolution or first.gaussians with --set, or use --device cpu",
    )


def rays_that_fit(device: torch.device, free: Callable[[torch.device], int] | None = None) -> int:
    """Return how many rays relighting may trace at once on a device.

    Args:
        device: the device; the CPU always takes RAYS.
        free: returns the free bytes of the device's memory; None measures them.
    """
    if free is None:
        free = _free_on_gpu
    return max(FEWEST, min(RAYS, int(USABLE * free(device)) // RAY)) if device.type == "cuda" else RAYS


def _free_on_gpu(device: torch.device) -> int:
    """Return the free bytes of the GPU's memory, with those that torch has reserved and does not use."""
    unused = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return torch.cuda.mem_get_info(device)[0] + unused
