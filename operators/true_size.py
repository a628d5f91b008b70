# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that give a capture its true size: place two ends, and scale the dataset by their known distance."""

# pyright: reportInvalidTypeForm=false

from pathlib import Path

import bpy
from bpy.props import BoolProperty, FloatProperty, StringProperty

from ..core.errors import InputError
from ..irgspp_addon.importer.capture_file import read_capture
from ..irgspp_addon.importer.dataset_import import checked
from ..irgspp_addon.importer.measure import measured_points, place_ends
from ..irgspp_addon.translations import translated
from .blocking import SKIP, WAIT, Queued, refusing, run_to_end
from .capture import start_change, use_capture

FOLDER = {
    "name": "Captured Dataset",
    "description": "Folder of a finished capture. Empty: the panel's",
    "subtype": "DIR_PATH",
    "options": SKIP,
}


def captured_folder(directory: str, scene: bpy.types.Scene) -> Path:
    """Return the folder of a finished capture that the user named, or the panel's.

    Args:
        directory: what was named; empty for the panel's dataset.
        scene: with the panel's settings.

    Raises:
        InputError: if it is none.
    """
    folder = checked(directory or str(scene.irgspp.dataset_path() or ""))
    capture = read_capture(folder)
    if capture is None or capture.status != "done":
        raise InputError(folder, "is not a finished capture", "find the cameras of its photographs first")
    return folder


class IRGSPP_OT_place_ends(bpy.types.Operator):
    """Add two empties to the imported capture: move them, with snapping, to two points whose distance you know."""

    bl_idname = "irgspp.place_ends"
    bl_label = "Measure Two Points"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 (Blender wants a plain set)

    directory: StringProperty(**FOLDER)

    @refusing()
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the empties and select them."""
        ends = place_ends(context.scene, captured_folder(self.directory, context.scene))
        for thing in context.selected_objects:
            thing.select_set(False)
        for end in ends:
            end.select_set(True)
        context.view_layer.objects.active = ends[0]
        return {"FINISHED"}


class IRGSPP_OT_true_size(Queued, bpy.types.Operator):
    """Give the captured dataset its true size: the two measured points are as far apart as you say."""

    bl_idname = "irgspp.true_size"
    bl_label = "Set True Size"
    bl_options = {"REGISTER"}  # noqa: RUF012 (Blender wants a plain set)

    directory: StringProperty(**FOLDER)
    distance: FloatProperty(name="Distance", description="True distance of the measured points, in metres", min=0.0, options=SKIP)
    import_result: BoolProperty(name="Import", description="Import the dataset again when it is done", default=True, options=SKIP)
    wait: BoolProperty(**WAIT)

    @refusing(RuntimeError)
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the job that scales the dataset."""
        scene = context.scene
        folder = captured_folder(self.directory, scene)
        metres = self.distance if self.properties.is_property_set("distance") else scene.irgspp.capture_distance
        if metres <= 0:
            raise InputError("distance", "is 0", "enter the true distance of the measured points in metres")
        options = ["--distance", *(f"{value:.7g}" for value in measured_points(scene, folder).ravel()), f"{metres:.9f}m"]
        on_done = "import_capture" if self.import_result and not self.wait else None
        job = start_change(scene, folder, translated("Set the true size of {name}", name=folder.name), options, on_done)
        ended = run_to_end(self, job) if self.wait else {"FINISHED"}
        if self.wait and ended == {"FINISHED"} and self.import_result:
            use_capture(scene, job, wait=True)
        return ended


CLASSES = (IRGSPP_OT_place_ends, IRGSPP_OT_true_size)
