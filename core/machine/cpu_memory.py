# SPDX-License-Identifier: GPL-3.0-or-later
"""Main memory of a job: estimated before the job starts, and made to fit into the free memory by tracing fewer rays at once."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..settings.schema import Settings

MIB = 1 << 20
# Measured with scripts/faults.py --only memory.
LIBRARIES = 420 * MIB  # torch, numba, their code and that of the compiled kernels
PHOTOGRAPH = 40  # bytes per pixel: colour and alpha, goals of the normals
PREPARED, MOST_PREPARED = 89, 2 << 30  # bytes per pixel, and at most: training views and G-buffers, which are kept up to a limit
GAUSSIAN = 4 * 63 * 4 + 500  # bytes: parameters, gradients, two moments; entries in tile lists
TRACING = 400 * MIB  # hits of MOST_RAYS rays
TEXEL = 80  # bytes while textures are baked: peaks of 0.9, 1.1 and 1.9 GiB at 1024, 2048 and 4096 texels
# Bytes while they take detail: candidates and their texels; a decoded photograph of 12 megapixels, its reductions and maps. Peaks of 1.2,
# 1.3 and 2.0 GiB with 3 photographs, 2.8 GiB with 24 at 4096 texels.
DETAIL_TEXEL, DETAIL_PIXEL = 90, 25
MOST_RAYS, FEWEST_RAYS = 1 << 18, 1 << 14  # traced at once
USABLE = 0.95  # fraction of the free memory that a job may plan with
CGROUPS = (("memory.max", "memory.current"), ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"))
CGROUP = Path("/sys/fs/cgroup")
UNLIMITED = 1 << 60


@dataclass(frozen=True)
class FreeMemory:
    """Memory that this process may still allocate.

    Attributes:
        size: bytes beyond those already in use.
        limit: what sets the limit, in words for the user.
    """

    size: int
    limit: str


def estimate_memory(settings: Settings, pixels: int, rays: int = MOST_RAYS) -> int:
    """Estimate the peak memory in bytes of a job on the CPU, libraries included.

    Args:
        settings: settings of the job.
        pixels: number of pixels of all photographs together.
        rays: number of rays traced at once.
    """
    second = settings.second
    texels = 2 * second.rows**2
    views = second.points * second.views * texels * 4 * 5  # light rows of each view, and equations of the same size
    points = second.points * 4 * texels * 4 * 6  # incoming radiance of each point from all directions
    stored = pixels * PHOTOGRAPH + min(pixels * PREPARED, MOST_PREPARED) + settings.first.gaussians * GAUSSIAN
    work = max(TRACING * rays // MOST_RAYS + points, points + views, settings.surface.texels**2 * max(TEXEL, DETAIL_TEXEL))
    return LIBRARIES + stored + work


def texture_memory(texels: int, pixels: int, photograph: float = 0.0) -> int:
    """Estimate the peak memory in bytes of the baking of textures and, after it, of their detail, libraries included.

    Args:
        texels: along a side of each texture.
        pixels: number of pixels of all views together.
        photograph: number of pixels of a full-size photograph from which they take detail.
    """
    detail = texels**2 * DETAIL_TEXEL + round(photograph * DETAIL_PIXEL)
    return LIBRARIES + min(pixels * PREPARED, MOST_PREPARED) + max(texels**2 * TEXEL, detail)


def check_texture_memory(texels: int, pixels: int, photograph: float = 0.0, free: FreeMemory | None = None) -> None:
    """Check that textures fit into main memory, where they are baked on any device.

    Args:
        texels: along a side of each texture.
        pixels: number of pixels of all views together; 0 where they are not known yet.
        photograph: number of pixels of a full-size photograph from which they take detail; 0 where it is not known yet.
        free: the memory to fit into; None measures it.

    Raises:
        InputError: if they do not.
    """
    available, used = free or free_memory(), resident_memory()
    needed = texture_memory(texels, pixels, photograph)
    if needed - used > USABLE * available.size:
        usable = f"but only {(available.size + used) / 2**30:.1f} GiB are available ({available.limit})"
        what = f"textures of {texels} texels need about {needed / 2**30:.1f} GiB to be baked, {usable}"
        raise InputError("memory", what, "choose a smaller texture size, or close other programs")


def rays_that_fit(settings: Settings, pixels: int, free: FreeMemory | None = None) -> int:
    """Return how many rays may be traced at once so that the job fits into memory.

    Args:
        settings: settings of the job.
        pixels: number of pixels of all photographs together.
        free: the memory to fit into; None measures it.

    Raises:
        InputError: if the job does not fit even with FEWEST_RAYS.
    """
    available, used, rays = free or free_memory(), resident_memory(), MOST_RAYS
    while estimate_memory(settings, pixels, rays) - used > USABLE * available.size:
        if rays <= FEWEST_RAYS:
            needed = f"{estimate_memory(settings, pixels, rays) / 2**30:.1f} GiB"
            usable = f"but only {(available.size + used) / 2**30:.1f} GiB are available ({available.limit})"
            fix = "close other programs, or lower data.resolution, first.gaussians, second.points or surface.texture with --set"
            raise InputError("memory", f"the job needs about {needed}, {usable}", fix)
        rays //= 2
    return rays


def free_memory() -> FreeMemory:
    """Return the smallest of the system's free memory and what the limits of this process (ulimit -v) and of its cgroup leave."""
    import psutil

    limits = [FreeMemory(psutil.virtual_memory().available, "free on this machine")]
    limits += [*_left_by_cgroup(), *_left_by_process_limit()]
    return min(limits, key=lambda one: one.size)


def resident_memory() -> int:
    """Return the bytes of physical memory that this process uses."""
    import psutil

    return psutil.Process().memory_info().rss


def _left_by_cgroup() -> list[FreeMemory]:
    """Return what the limit of the cgroup leaves (version 2 or 1); empty where there is no limit."""
    for limit, usage in CGROUPS:
        try:
            most, used = int((CGROUP / limit).read_text()), int((CGROUP / usage).read_text())
        except (OSError, ValueError):  # no such file, or the word max
            continue
        return [FreeMemory(max(most - used, 0), "the limit of its cgroup")] if most < UNLIMITED else []
    return []


def _left_by_process_limit() -> list[FreeMemory]:
    """Return what `ulimit -v` leaves; empty where there is no limit."""
    if sys.platform == "win32":
        return []
    import resource

    import psutil

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit in (resource.RLIM_INFINITY, -1):
        return []
    return [FreeMemory(max(limit - psutil.Process().memory_info().vms, 0), "the limit of this process, ulimit -v")]
