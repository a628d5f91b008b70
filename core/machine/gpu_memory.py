# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job takes of a GPU's memory, estimated before it starts, and how that is made to fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from ..errors import InputError
from ..settings.schema import Settings

MIB = 1 << 20
CONTEXT = 600 * MIB  # of CUDA itself, torch's libraries and warp's kernels
SHARE = 0.9  # of what is free that is counted on: memory is never without gaps
GAUSSIAN = 4 * 63 * 4  # bytes: 63 parameters, their gradients and Adam's two moments
ENTRIES = 16.0  # of a Gaussian in the lists of tiles, with their spare room
ENTRY = 8 + 8 + 4 + 2 * 4 * (10 + 11)  # bytes: key, sorted place, owner, gradients of two warps
PIXEL = 4 * (3 * 20 + 60)  # bytes of an image that is drawn and goes back: sums, gradients, what autograd keeps
PHOTOGRAPH = 4 * (3 + 1 + 3 + 3) + 3  # bytes of a pixel of a target: image, alpha, rays twice, saturation
RAY = 400  # bytes of a ray of the second stage or of relighting, with its direction, density and sums
RAYS = 1 << 22  # of relighting that are at work at a time, at most
FEWEST = 1 << 14


@dataclass(frozen=True)
class Plan:
    """How a job is laid out.

    Attributes:
        needed: bytes, about. targets: photographs stay on the GPU, else each is brought there for its step.
    """

    needed: int
    targets: bool


def estimate_gpu_memory(settings: Settings, views: int, width: int, height: int, targets: bool) -> int:
    """About how many bytes the largest step of a job takes."""
    pixels = width * height
    first = settings.first.gaussians * int(GAUSSIAN + ENTRIES * ENTRY) + pixels * PIXEL
    transport, texels = settings.second, 2 * settings.second.rows**2
    points = transport.points * texels * 4 * (4 * 4 + 1) + transport.points * transport.views * texels * 4 * 6
    second = max(points, transport.pixels * transport.samples * RAY) + settings.first.gaussians * GAUSSIAN
    kept = views * pixels * PHOTOGRAPH if targets else 0
    return CONTEXT + kept + max(first, second, FEWEST * RAY)


def plan(settings: Settings, views: int, width: int, height: int, free: int) -> Plan:
    """The layout that fits into `free` bytes of the GPU's memory. Raises InputError where none does."""
    needed = 0
    for targets in (True, False):
        needed = estimate_gpu_memory(settings, views, width, height, targets)
        if needed <= SHARE * free:
            return Plan(needed, targets)
    raise InputError(
        "--device cuda",
        f"the job takes about {needed / 2**30:.1f} GiB of the GPU's memory, of which {free / 2**30:.1f} GiB are free",
        "give --set data.resolution=... or first.gaussians=... less, or use --device cpu",
    )


def rays_that_fit(device: torch.device, free: Callable[[torch.device], int] | None = None) -> int:
    """How many rays of relighting are at work at a time: fewer where less of the GPU's memory is `free`."""
    if free is None:
        free = _free_on_gpu
    return max(FEWEST, min(RAYS, int(SHARE * free(device)) // RAY)) if device.type == "cuda" else RAYS


def _free_on_gpu(device: torch.device) -> int:
    """Bytes that nobody has, and those that torch has and does not use."""
    held = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return torch.cuda.mem_get_info(device)[0] + held
