# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of a finished job's result into the scene from which the job was started."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bpy

from ...core.errors import IrgsppError
from .job import Job
from .session import session_file

_loads = 0  # number of files that this Blender has opened


def another_file() -> None:
    """Note that another file has been opened."""
    global _loads
    _loads += 1


def place_of(scene: bpy.types.Scene, material: str = "textures", pack: bool = True) -> dict[str, Any]:
    """Return the data that a job needs to import its result into a scene later.

    Args:
        scene: scene for the result.
        material: source of the material's values, "textures" or "attributes".
        pack: True to pack textures and light into the .blend.
    """
    place = {"session": session_file().name, "loads": _loads, "file": bpy.data.filepath, "scene": scene.name}
    return {"place": place, "material": material, "pack": pack}


def saved(jobs: Iterable[Job], file: str) -> None:
    """Note in the jobs of the open file where it has been saved, so that they find it again in another session.

    Args:
        jobs: all jobs.
        file: path of the .blend file.
    """
    for job in jobs:
        place = job.data.get("place")
        if place and (place["session"], place["loads"]) == (session_file().name, _loads) and place["file"] != file:
            place["file"] = file
            job.save_if_possible()


def renew_place(job: Job, scene: bpy.types.Scene) -> None:
    """Let a job that is resumed deliver into the scene in which it is resumed, if its own file was never saved or is gone.

    Args:
        job: stopped job.
        scene: scene in which it is resumed.
    """
    place = job.data.get("place")
    if place and not is_open(place) and not (place["file"] and Path(place["file"]).is_file()):
        job.data["place"] = place_of(scene)["place"]


def is_open(place: dict[str, Any]) -> bool:
    """Return True if the file that a job was started from is open."""
    same = (place["session"], place["loads"]) == (session_file().name, _loads)
    return same or bool(place["file"] and place["file"] == bpy.data.filepath)


@contextmanager
def started_from(job: Job, otherwise: str) -> Iterator[bpy.types.Scene]:
    """Make the scene from which the job was started the context's scene within the block.

    Args:
        job: finished job with the data of `place_of`.
        otherwise: advice for the error message, how to get the result in another file.

    Raises:
        IrgsppError: if another file has been opened since.
    """
    place = job.data["place"]
    if not is_open(place):
        raise IrgsppError(f"another file is open now; {otherwise}")
    scene = bpy.data.scenes.get(place["scene"]) or bpy.context.scene
    window = next(iter(bpy.context.window_manager.windows), None)
    override: dict[str, Any] = {"scene": scene, "view_layer": scene.view_layers[0]}
    if window is not None and not bpy.app.background:
        override["window"] = window
        if window.scene == scene:
            override["view_layer"] = window.view_layer
    with bpy.context.temp_override(**override):
        yield scene


def import_result(job: Job) -> None:
    """Import a finished run into the scene from which it was started; raise IrgsppError if another file has been opened since."""
    with started_from(job, f"get the result by File > Import > IRGS++ Run from {job.folder}"):
        words = {"directory": str(job.folder), "material": job.data["material"], "pack": job.data["pack"]}
        bpy.ops.irgspp.import_run("EXEC_DEFAULT", True, arrange=True, **words)


ON_DONE = {"import_result": import_result}
