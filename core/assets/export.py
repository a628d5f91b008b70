# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of a finished run: asset for other programs, Blender scene, Gaussians (PLY) or light (EXR)."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..errors import InputError
from ..io.atomic import atomic_file
from ..machine.blender_process import check_written, run_in_blender
from ..progress.protocol import Progress, Silent
from .options import ASSETS, SUFFIXES, AssetOptions

COPIES = {".ply": "gaussians.ply", ".exr": "environment.exr"}


def export(
    run: Path, target: Path, material: str = "textures", progress: Progress | None = None, options: AssetOptions | None = None
) -> None:
    """Write one part of a finished run to a file of the user's.

    Args:
        run: folder of the finished run.
        target: file to write; its suffix decides: .glb, .usd, .usdc, .usda, .usdz, .obj and .fbx asset, .blend scene, .ply Gaussians,
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
    if suffix in COPIES and options != AssetOptions():
        raise InputError(target, f"{suffix} has no levels of detail, hulls or textures", f"use {', '.join((*ASSETS, '.blend'))}")
    if suffix in COPIES:
        _copy(run / COPIES[suffix], target)
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


def write_blend(run: Path, target: Path, material: str, progress: Progress) -> None:
    """Write the run as a .blend file in a separate Blender process.

    Args:
        run: folder of the finished run.
        target: .blend file to write.
        material: what the material reads, "textures" or "attributes".
        progress: asked whether to stop.

    Raises:
        InputError: when the run has no mesh, or the file can't be written.
        Cancelled: when the user stops the work.
        NoBlender: when no Blender is found.
        IrgsppError: when Blender fails.
    """
    if not (run / "mesh.ply").is_file():
        raise InputError(run / "mesh.ply", "is missing", "finish the reconstruction first")
    arguments = [str(run.resolve()), str(target.resolve()), "--material", material]
    status, last_line = run_in_blender("irgspp_addon.importer.write_blend", arguments, lambda: progress.cancelled)
    check_written(status, last_line, target, target)


def _copy(source: Path, target: Path) -> None:
    if not source.is_file():
        raise InputError(source, "is missing", "finish the reconstruction first")
    with atomic_file(target) as partial:
        shutil.copyfile(source, partial)
