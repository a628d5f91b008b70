# SPDX-License-Identifier: GPL-3.0-or-later
"""What leaves a run folder: asset, Blender scene, Gaussians or light."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..errors import InputError, IrgsppError
from ..io.atomic import atomic_file
from ..machine.blender_process import run_in_blender
from ..progress.protocol import Progress, Silent

COPIES = {".glb": "asset.glb", ".ply": "gaussians.ply", ".exr": "environment.exr"}


def export(run: Path, target: Path, material: str = "textures", progress: Progress | None = None) -> None:
    """Write `target` from a finished run, by its suffix: .glb asset, .blend scene, .ply Gaussians, .exr light.

    Raises InputError for another suffix or where the run lacks the part.
    """
    suffix = target.suffix.lower()
    if suffix not in {".blend", *COPIES}:
        raise InputError(target, f"can't export to {suffix or 'a name without suffix'}", "use .glb, .blend, .ply or .exr")
    if not run.is_dir():
        raise InputError(run, "is not a run folder")
    if not target.resolve().parent.is_dir():
        raise InputError(target.parent, "no such folder")
    if suffix == ".blend":
        write_blend(run, target, material, progress or Silent())
    else:
        _copy(run / COPIES[suffix], target)


def write_blend(run: Path, target: Path, material: str, progress: Progress) -> None:
    """Write the run as a .blend in a Blender of its own.

    `material` says what the material reads: "textures" or "attributes". Raises InputError, Cancelled, NoBlender, or IrgsppError
    where Blender fails.
    """
    if not (run / "mesh.ply").is_file():
        raise InputError(run / "mesh.ply", "is missing", "finish the reconstruction first")
    arguments = [str(run.resolve()), str(target.resolve()), "--material", material]
    status, said = run_in_blender("irgspp_addon.importer.write_blend", arguments, lambda: progress.cancelled)
    if status == InputError.exit_status:
        raise InputError(target, f"not written: {said}")
    if status or not target.is_file():
        raise IrgsppError(f"{target}: Blender ended with status {status}: {said}")


def _copy(source: Path, target: Path) -> None:
    if not source.is_file():
        raise InputError(source, "is missing", "finish the reconstruction first")
    with atomic_file(target) as partial:
        shutil.copyfile(source, partial)
