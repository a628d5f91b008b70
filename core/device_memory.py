# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job takes of a GPU's memory, estimated before it starts, and how that is made to fit."""

from __future__ import annotations

from dataclasses import dataclass

from .config import Settings
from .errors import InputError

MIB = 1 << 20
CONTEXT = 600 * MIB  # of CUDA itself, torch's libraries and warp's kernels
SHARE = 0.9  # of what is free that is counted on: memory is never without gaps
GAUSSIAN = 4 * 63 * 4  # bytes: 63 parameters, their gradients and Adam's two moments
ENTRIES = 16.0  # of a Gaussian in the lists of tiles, with their spare room
ENTRY = 8 + 8 + 4 + 2 * 4 * (10 + 11)  # bytes: key, sorted place, owner, gradients of two warps
PIXEL = 4 * (3 * 20 + 60)  # bytes of a picture that is drawn and goes back: sums, gradients, what autograd keeps
PHOTOGRAPH = 4 * (3 + 1 + 3 + 3) + 3  # bytes of a pixel of a target: picture, alpha, rays twice, saturation
RAY = 400  # bytes of a ray of the second stage or of relighting, with its direction, density and sums
RAYS = 1 << 22  # of relighting that are at work at a time
FEWEST = 1 << 14


@dataclass(frozen=True)
class Plan:
    """How a job is laid out.

    Attributes:
        needed: bytes, about. targets: photographs stay on the GPU, else each is brought there for its step. rays: at work at a time.
    """

    needed: int
    targets: bool
    rays: int


def bytes_needed(settings: Settings, views: int, width: int, height: int, targets: bool, rays: int) -> int:
    """About how many bytes the largest step of a job takes."""
    pixels = width * height
    first = settings.reflective.gaussians * int(GAUSSIAN + ENTRIES * ENTRY) + pixels * PIXEL
    transport, texels = settings.transport, 2 * settings.transport.rows**2
    points = transport.points * texels * 4 * (4 * 4 + 1) + transport.points * transport.views * texels * 4 * 6
    second = max(points, transport.pixels * transport.samples * RAY) + settings.reflective.gaussians * GAUSSIAN
    kept = views * pixels * PHOTOGRAPH if targets else 0
    return CONTEXT + kept + max(first, second, rays * RAY)


def plan(settings: Settings, views: int, width: int, height: int, free: int) -> Plan:
    """The layout that fits into `free` bytes of the GPU's memory. Raises InputError where none does."""
    room = int(SHARE * free)
    layouts = [(True, RAYS), (False, RAYS)]
    while layouts[-1][1] > FEWEST:
        layouts.append((False, layouts[-1][1] // 4))
    for targets, rays in layouts:
        needed = bytes_needed(settings, views, width, height, targets, rays)
        if needed <= room:
            return Plan(needed, targets, rays)
    raise InputError(
        "--device cuda",
        f"the job takes about {needed / 2**30:.1f} GiB of the GPU's memory, of which {free / 2**30:.1f} GiB are free",
        "give --set data.resolution=... or reflective.gaussians=... less, or use --device cpu",
    )
