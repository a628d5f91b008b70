# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job takes of the machine's memory, estimated before it starts, compared with what it may take, and made to fit."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..settings.schema import Settings

MIB = 1 << 20
# Measured with scripts/faults.py --only memory.
LIBRARIES = 420 * MIB  # torch, numba, their code and the kernels' once all are loaded
PHOTOGRAPH = 129  # bytes of a pixel: colour and alpha, the same as a target of the first stage, layers rendered for the surface
GAUSSIAN = 4 * 63 * 4 + 500  # parameters, gradients, two moments; place in lists
TRACING = 400 * MIB  # what rays at work meet, for MOST_RAYS of them
TEXEL = 64  # bytes while textures are made
MOST_RAYS, FEWEST_RAYS = 1 << 18, 1 << 14
SHARE = 0.95  # of what is free that is counted on
CGROUPS = (("memory.max", "memory.current"), ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"))
CGROUP = Path("/sys/fs/cgroup")
UNLIMITED = 1 << 60


@dataclass(frozen=True)
class Free:
    """Bytes that this process may take beyond what it has, and what sets the limit, in words."""

    size: int
    limit: str


def estimate_memory(settings: Settings, pixels: int, rays: int = MOST_RAYS) -> int:
    """Estimate the bytes of memory that a job on the CPU has in use at most, libraries included.

    Args:
        settings: of the job.
        pixels: of all photographs together.
        rays: at work at a time.
    """
    second = settings.second
    texels = 2 * second.rows**2
    views = second.points * second.views * texels * 4 * 5  # rows of light of each view, and the equations' of the same size
    points = second.points * 4 * texels * 4 * 6  # what shines on each point from all around
    kept = pixels * PHOTOGRAPH + settings.first.gaussians * GAUSSIAN
    work = max(TRACING * rays // MOST_RAYS + points, points + views, settings.surface.texture**2 * TEXEL)
    return LIBRARIES + kept + work


def rays_that_fit(settings: Settings, pixels: int, free: Free | None = None) -> int:
    """How many rays may be at work at a time so that the job fits into memory. Raises InputError where it does not even with few."""
    room, taken, rays = free or free_memory(), resident(), MOST_RAYS
    while estimate_memory(settings, pixels, rays) - taken > SHARE * room.size:
        if rays <= FEWEST_RAYS:
            needed = f"{estimate_memory(settings, pixels, rays) / 2**30:.1f} GiB"
            there = f"{(room.size + taken) / 2**30:.1f} GiB can be had ({room.limit})"
            fix = "close other programs, or give --set data.resolution=..., first.gaussians=... or second.points=... less"
            raise InputError("memory", f"the job needs about {needed}, {there}", fix)
        rays //= 2
    return rays


def free_memory() -> Free:
    """The tightest of what the system has free, a limit of this process (ulimit -v), and that of its group (cgroup)."""
    import psutil

    found = [Free(psutil.virtual_memory().available, "free on this machine")]
    found += [*_of_group(), *_of_process()]
    return min(found, key=lambda one: one.size)


def resident() -> int:
    """Bytes that this process has in use."""
    import psutil

    return psutil.Process().memory_info().rss


def _of_group() -> list[Free]:
    """What is left of a cgroup's limit, of either version."""
    for limit, usage in CGROUPS:
        try:
            most, used = int((CGROUP / limit).read_text()), int((CGROUP / usage).read_text())
        except (OSError, ValueError):  # no such file, or the word max
            continue
        return [Free(max(most - used, 0), "the limit of its cgroup")] if most < UNLIMITED else []
    return []


def _of_process() -> list[Free]:
    if sys.platform == "win32":
        return []
    import resource

    import psutil

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit in (resource.RLIM_INFINITY, -1):
        return []
    return [Free(max(limit - psutil.Process().memory_info().vms, 0), "the limit of this process, ulimit -v")]
