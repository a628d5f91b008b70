# SPDX-License-Identifier: GPL-3.0-or-later
"""The result of a finished reconstruction into the scene that it was started from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from ...core.errors import IrgsppError
from .job import Job
from .session import session_file

_loads = 0  # files that this Blender has opened


def another_file() -> None:
    """A file was loaded."""
    global _loads
    _loads += 1


def place_of(scene: bpy.types.Scene, material: str = "textures", pack: bool = True) -> dict[str, Any]:
    """What a job must know to put its result into the scene later."""
    place = {"session": session_file().name, "loads": _loads, "file": bpy.data.filepath, "scene": scene.name}
    return {"place": place, "material": material, "pack": pack}


@contextmanager
def started_from(job: Job, otherwise: str) -> Iterator[bpy.types.Scene]:
    """Within the block the scene that the job was started from is the context's.

    Raises IrgsppError where another file is open now; `otherwise` says how to get the result then.
    """
    place = job.data["place"]
    same = (place["session"], place["loads"]) == (session_file().name, _loads)
    if not same and not (place["file"] and place["file"] == bpy.data.filepath):
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
    """Import the run where its scene is still open; say how to get it where another file is open now."""
    with started_from(job, f"get the result by File > Import > IRGS++ Run from {job.folder}"):
        bpy.ops.irgspp.import_run("EXEC_DEFAULT", True, directory=str(job.folder), material=job.data["material"], pack=job.data["pack"])


ON_DONE = {"import_result": import_result}
