# SPDX-License-Identifier: GPL-3.0-or-later
"""Disk space of a job: estimated and checked before the job starts."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..errors import InputError
from ..settings.schema import Settings, SurfaceSettings

MEGABYTE = 1_000_000
PARAMETERS = 63  # of a Gaussian; Adam stores two moments of each
COLUMNS = 71  # of gaussians.ply, which holds the normals too
VERTEX, TRIANGLE = 67, 13  # bytes in mesh.ply
COPIES = 3  # of mesh and textures: their own files, asset.glb, scene.blend; one more of textures as UDIM tiles
TEXEL, DEEP_TEXEL = 8, 16  # bytes of all textures together, uncompressed, of 8 and of 16 bits
PHOTOGRAPH = 0.6  # bytes per pixel of an undistorted copy
REST = 8 * MEGABYTE  # contact sheet, previews, light, events


def estimate_disk_space(settings: Settings, undistorted: int) -> int:
    """Estimate the bytes that a run folder takes at most while its job runs, which is more than it takes in the end.

    Args:
        settings: settings of the job.
        undistorted: number of pixels of all photographs that the run folder holds an undistorted copy of.
    """
    gaussians = settings.first.gaussians
    checkpoints = 2 * 3 * gaussians * PARAMETERS * 4  # the present one, and the next until it has replaced that
    results = 2 * gaussians * COLUMNS * 4  # of both stages
    bare = 8 * settings.surface.voxels**2 * (VERTEX + 2 * TRIANGLE) // 4  # approximately the fused surface before decimation
    return int(checkpoints + results + bare + texture_disk_space(settings.surface) + undistorted * PHOTOGRAPH + REST)


def texture_disk_space(surface: SurfaceSettings) -> int:
    """Estimate the bytes of a mesh with its textures in all files of a run folder that hold them."""
    texel = TEXEL if surface.texture_bits == 8 else DEEP_TEXEL
    images = COPIES + (surface.udim_tiles > 1)
    return COPIES * surface.triangles * (VERTEX // 2 + TRIANGLE) + images * surface.texels**2 * texel


def check_disk_space(run: Path, settings: Settings, undistorted: int) -> None:
    """Check that the disk of the run folder, which need not exist yet, has enough free space for the job.

    Args:
        run: the run folder; files already in it count as space that the job has.
        settings: settings of the job.
        undistorted: number of pixels of all photographs that the run folder holds an undistorted copy of.

    Raises:
        InputError: if there is not enough free space.
    """
    used = sum(file.stat().st_size for file in run.rglob("*") if file.is_file()) if run.is_dir() else 0
    needed, free = estimate_disk_space(settings, undistorted) - used, free_disk_space(run)
    if needed > free:
        what = f"the job needs about {_formatted(needed)} of disk space, of which {_formatted(free)} are free"
        raise InputError(run, what, "free some disk space, or choose a folder on another disk")


def check_texture_disk_space(run: Path, surface: SurfaceSettings) -> None:
    """Check that the disk has enough free space for textures that are written before they replace others.

    Args:
        run: the run folder.
        surface: settings with the texture size.

    Raises:
        InputError: if there is not enough free space.
    """
    needed, free = texture_disk_space(surface), free_disk_space(run)
    if needed > free:
        what = f"textures of {surface.texels} texels need about {_formatted(needed)} of disk space, of which {_formatted(free)} are free"
        raise InputError(run, what, "free some disk space, or choose a smaller size")


def free_disk_space(run: Path) -> int:
    """Return the free bytes of the disk of a folder, which need not exist yet."""
    return shutil.disk_usage(next(p for p in (run, *run.absolute().parents) if p.exists())).free


def _formatted(size: int) -> str:
    return f"{size / 1000 / MEGABYTE:.1f} GB" if size >= 1000 * MEGABYTE else f"{max(size, 0) / MEGABYTE:.0f} MB"
