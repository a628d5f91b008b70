# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of a finished run: GLB asset, Blender scene, Gaussians (PLY) or light (EXR)."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..errors import InputError, IrgsppError
from ..io.atomic import atomic_file
from ..machine.blender_process import run_in_blender
from ..progress.protocol import Progress, Silent

COPIES = {".glb": "asset.glb", ".ply": "gaussians.ply", ".exr": "environment.exr"}


def export(run: Path, target: Path, material: str = "textures", progress: Progress | None = None) -> None:
    """Write one part of a finished run to a file of the user's.

    Args:
        run: folder of the finished run.
        target: file to write; its suffix decides: .glb asset, .blend scene, .ply Gaussians, .exr light.
        material: what the material of a .blend reads, "textures" or "attributes".
        progress: asked whether to stop.

    Raises:
        InputError: when the suffix is another one, a folder does not exist, or the run lacks the part.
        Cancelled: when the user stops the work.
        NoBlender: when a .blend is asked for and no Blender is found.
        IrgsppError: when Blender fails.
    """
    suffix = target.suffix.lower()
    if suffix not in {".blend", *COPIES}:
        raise InputError(target, f"can't export to {suffix or 'a name without suffix'}", "use .glb, .blend, .ply or .exr")
    if not run.is_dir():
        raise InputError(run, "is not a run folder", "give a folder that `irgspp reconstruct` wrote")
    if not target.resolve().parent.is_dir():
        raise InputError(target.parent, "no such folder", "create it first")
    if suffix == ".blend":
        write_blend(run, target, material, progress or Silent())
    else:
        _copy(run / COPIES[suffix], target)


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
    if status == InputError.exit_status:
        raise InputError(target, f"not written: {last_line}")
    if status or not target.is_file():
        raise IrgsppError(f"{target}: Blender ended with status {status}: {last_line}")


def _copy(source: Path, target: Path) -> None:
    if not source.is_file():
        raise InputError(source, "is missing", "finish the reconstruction first")
    with atomic_file(target) as partial:
        shutil.copyfile(source, partial)
