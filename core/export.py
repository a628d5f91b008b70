# SPDX-License-Identifier: GPL-3.0-or-later
"""What leaves a run folder: asset, Blender scene, Gaussians or light."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from .errors import Cancelled, InputError, IrgsppError
from .progress import Progress, Silent

LAUNCHER = Path(__file__).resolve().parent.parent / "irgspp_addon" / "launch.py"
BLENDER = "IRGSPP_BLENDER"  # the environment variable that names a Blender executable; the extension sets it to the one it runs in
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


class NoBlender(IrgsppError):
    """There is no Blender that could write a .blend."""


def blender_command() -> list[str]:
    """What runs launch.py in a Blender: the executable that $IRGSPP_BLENDER names, or this Python where it has the module bpy.

    The named one goes first: a .blend is then of the version that its user has. Raises NoBlender where there is neither.
    """
    named = os.environ.get(BLENDER, "")
    if named:
        executable = shutil.which(named)
        if executable is None:
            raise NoBlender(f"${BLENDER} names {named}, which is no program")
        return [executable, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(LAUNCHER), "--"]
    if importlib.util.find_spec("bpy") is None:
        raise NoBlender(f"Blender's Python module (bpy) is not installed, and ${BLENDER} names no Blender")
    return [sys.executable, str(LAUNCHER)]


def write_blend(run: Path, target: Path, material: str, progress: Progress) -> None:
    """Write the run as a .blend in a Blender of its own (`blender_command`), since the engine can't share a process with one.

    `material` says what the material reads: "textures" or "attributes". Raises InputError, Cancelled, NoBlender, or IrgsppError
    where Blender fails.
    """
    if not (run / "mesh.ply").is_file():
        raise InputError(run / "mesh.ply", "is missing", "finish the reconstruction first")
    command = [*blender_command(), "irgspp_addon.write_blend", str(run.resolve()), str(target.resolve()), "--material", material]
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=errors)
        status = _wait(child, progress)
        errors.seek(0)
        said = [line.strip() for line in errors if line.strip() and "not freed memory" not in line.lower()]
    if status == InputError.exit_status:
        raise InputError(target, f"not written: {said[-1] if said else 'bad input'}")
    if status or not target.is_file():
        raise IrgsppError(f"{target}: Blender ended with status {status}: {said[-1] if said else 'no message'}")


def _wait(child: subprocess.Popen, progress: Progress) -> int:
    while True:
        try:
            return child.wait(timeout=0.2)
        except subprocess.TimeoutExpired:
            if progress.cancelled:
                child.terminate()
                child.wait()
                raise Cancelled("stopped while writing the .blend") from None


def _copy(source: Path, target: Path) -> None:
    if not source.is_file():
        raise InputError(source, "is missing", "finish the reconstruction first")
    partial = target.with_name(target.name + ".part")
    shutil.copyfile(source, partial)
    os.replace(partial, target)
