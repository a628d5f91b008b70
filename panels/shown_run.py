# SPDX-License-Identifier: GPL-3.0-or-later
"""Run that the panels show, and its object in the scene."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..irgspp_addon.importer.ownership import KEY, folder_of
from ..irgspp_addon.importer.run_root import RUN, find_roots, run_of
from .run_state import resolved, run_state


def shown_run(context: bpy.types.Context) -> Path | None:
    """Return the run of the active object, else that of the scene's settings, else the only one in the scene; None without any."""
    run = run_of(context.object) or resolved(context.scene.irgspp.run_path())
    if run is not None:
        return run
    roots = find_roots(context.scene, RUN)
    return folder_of(roots[0]) if len(roots) == 1 else None


def object_of_run(scene: bpy.types.Scene, run: Path | None) -> bpy.types.Object | None:
    """Return the mesh object of a run; None where it is not in the scene.

    Args:
        scene: to search.
        run: run folder; None without one.
    """
    key = f"{run}#mesh"
    return next((thing for thing in scene.objects if thing.type == "MESH" and thing.get(KEY) == key), None)


def is_finished(context: bpy.types.Context) -> bool:
    """Return True where the shown run is finished."""
    return run_state(shown_run(context)).status == "done"
