# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of a finished run: asset for other programs, Blender scene, splats (PLY) or light (EXR)."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.atomic import atomic_file
from ..progress.protocol import Progress, Silent
from .blend_file import write_blend
from .options import ASSETS, PARTS, SUFFIXES, UNTURNED, AssetOptions

LACKING = {".ply": "levels of detail, hulls or textures", ".exr": "levels of detail, hulls or textures, and is not turned or scaled"}


def export(
    run: Path, target: Path, material: str = "textures", progress: Progress | None = None, options: AssetOptions | None = None
) -> None:
    """Write one part of a finished run to a file of the user's.

    Args:
        run: folder of the finished run.
        target: file to write; its suffix decides: .glb, .usd, .usdc, .usda, .usdz, .obj and .fbx asset, .blend scene, .ply splats,
            .exr light.
        material: what the material of a .blend reads, "textures" or "attributes".
        progress: asked whether to stop.
        options: of the asset or scene; None: the defaults.

    Raises:
        InputError: when the suffix is another one, a folder does not exist, the run lacks the part, or an option doesn't fit the format.
        Cancelled: when the user stops the work.
        NoBlender: when a .blend is asked for and no Blender is found.
        IrgsppError: when Blender fails.
    """
    suffix, options, progress = target.suffix.lower(), options or AssetOptions(), progress or Silent()
    if suffix not in SUFFIXES:
        raise InputError(target, f"can't export to {suffix or 'a name without suffix'}", f"use {', '.join(SUFFIXES)}")
    if not run.is_dir():
        raise InputError(run, "is not a run folder", "give a folder that `irgspp reconstruct` wrote")
    if not target.resolve().parent.is_dir():
        raise InputError(target.parent, "no such folder", "create it first")
    if suffix in PARTS and options != AssetOptions(transform=options.transform if suffix == ".ply" else UNTURNED):
        raise InputError(target, f"{suffix} has no {LACKING[suffix]}", f"use {', '.join((*ASSETS, '.blend'))}")
    matrix = options.matrix(suffix)
    if suffix == ".exr":
        _copy(run / "environment.exr", target)
    elif suffix == ".ply":
        _export_splats(run, target, matrix, progress)
    elif suffix == ".blend" and options == AssetOptions():
        write_blend(run, target, material, progress)
    else:
        _export_object(run, target, material, options, progress)


def _export_object(run: Path, target: Path, material: str, options: AssetOptions, progress: Progress) -> None:
    from .production import export_asset, export_blend  # needs trimesh; the extension writes .blend files without

    if target.suffix.lower() == ".blend":
        export_blend(run, target, material, options, progress)
    else:
        export_asset(run, target, options, progress)


def _export_splats(run: Path, target: Path, transform: np.ndarray, progress: Progress) -> None:
    from .splats import write_splats  # needs torch and scipy; the extension writes .blend files without

    write_splats(run, target, progress, transform)


def _copy(source: Path, target: Path) -> None:
    if not source.is_file():
        raise InputError(source, "is missing", "finish the reconstruction first")
    with atomic_file(target) as partial:
        shutil.copyfile(source, partial)
