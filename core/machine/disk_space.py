# SPDX-License-Identifier: GPL-3.0-or-later
"""Room on the disk that a job needs, estimated and looked for before it starts."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..errors import InputError
from ..settings.schema import Settings

MEGABYTE = 1_000_000
PARAMETERS = 63  # numbers of a Gaussian; Adam keeps two moments of each
COLUMNS = 71  # of a Gaussian in gaussians.ply, which has their normals too
VERTEX, TRIANGLE = 67, 13  # bytes in mesh.ply
COPIES = 3  # of mesh and textures: as they are, in asset.glb, in scene.blend
TEXEL = 8  # bytes of all textures, if they could not be compressed
PHOTOGRAPH = 0.6  # bytes of a pixel of an undistorted copy
REST = 8 * MEGABYTE  # contact sheet, previews, light, events


def estimate_disk_space(settings: Settings, undistorted: int) -> int:
    """Estimate the bytes that a run folder takes while its job works: more than is left in the end.

    Args:
        settings: of the job.
        undistorted: pixels of all photographs that the run folder holds a copy of, without lens distortion.
    """
    gaussians = settings.first.gaussians
    checkpoints = 2 * 3 * gaussians * PARAMETERS * 4  # the present one and the next, until that has taken its place
    results = 2 * gaussians * COLUMNS * 4  # of both stages
    surface = settings.surface
    bare = 8 * surface.voxels**2 * (VERTEX + 2 * TRIANGLE) // 4  # the fused surface before it is decimated, about
    asset = COPIES * (surface.triangles * (VERTEX // 2 + TRIANGLE) + surface.texture**2 * TEXEL)
    return int(checkpoints + results + bare + asset + undistorted * PHOTOGRAPH + REST)


def check_disk_space(run: Path, settings: Settings, undistorted: int) -> None:
    """Raise InputError where the disk that the run folder is on, or would be, has less free than the job needs."""
    place = next(p for p in (run, *run.absolute().parents) if p.exists())
    there = sum(file.stat().st_size for file in run.rglob("*") if file.is_file()) if run.is_dir() else 0
    needed, free = estimate_disk_space(settings, undistorted) - there, shutil.disk_usage(place).free
    if needed > free:
        what = f"the job needs about {_shown(needed)} of the disk, of which {_shown(free)} are free"
        raise InputError(run, what, "free some room, or name a folder on another disk")


def _shown(size: int) -> str:
    return f"{size / 1000 / MEGABYTE:.1f} GB" if size >= 1000 * MEGABYTE else f"{max(size, 0) / MEGABYTE:.0f} MB"
