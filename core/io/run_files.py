# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a run folder: their names, whether a folder can be a run's, and their removal."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError

RESULTS = ("gaussians.ply", "environment.exr", "reflections.npz", "background.exr", "reconstruction.json")
FINE_SURFACE = "fine_surface.ply"  # fine surface with the normals of the second stage, where it found them
RESULTS += (FINE_SURFACE, "mesh.ply", "asset.glb", "scene.blend", "cameras.json", "contact_sheet.png")
CAPTURE = "capture"  # folder of the captured dataset, where photographs came without cameras
FOLDERS = (CAPTURE, "checkpoint", "textures", "evaluation", "photographs", "previews")
LOGS = ("events.jsonl", "log.txt", "cancel", "finish")
LOCK = ".lock"
OLD_CHECKPOINT, CHECKPOINT = "reflective.pt", "first_stage.pt"  # of the first stage, in version 0.1 and now
UNSTARTED = (LOCK, ".run.part.json")  # all files of a run that was killed before it wrote run.json


def check_claim(path: Path, resume: bool, overwrite: bool) -> None:
    """Check that a run can be written to a folder.

    Args:
        path: run folder; it need not exist.
        resume: a run in it is to be continued.
        overwrite: a run in it is to be replaced.

    Raises:
        InputError: `path` is a file, is not writable, or holds something else or a run that is neither resumed nor replaced.
    """
    parent = next(p for p in (path, *path.absolute().parents) if p.exists())
    if not parent.is_dir():
        raise InputError(path, f"can't be made, {parent} is a file" if parent != path else "is a file, not a folder")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(path, "is not writable")
    if not path.exists() or not any(p.name not in UNSTARTED for p in path.iterdir()):
        return
    if not (path / "run.json").is_file():
        raise InputError(path, "is not empty and not a run folder", "name another folder")
    if not resume and not overwrite:
        raise InputError(path, "holds another run", "resume it with --resume, replace it with --overwrite, or name another folder")


def clear(path: Path, kept: Sequence[str] = ()) -> None:
    """Remove a run's own files from its folder and nothing else; run.json stays, since it marks the folder as a run folder.

    Args:
        path: run folder.
        kept: folders that stay, too.
    """
    for name in FOLDERS:
        if name not in kept:
            shutil.rmtree(path / name, ignore_errors=True)
    for name in (*RESULTS, *LOGS):
        (path / name).unlink(missing_ok=True)
