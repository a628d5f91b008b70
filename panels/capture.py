# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of step 2 for photographs without cameras: the button that finds them, and what was found and left out."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.importer.capture_file import CaptureSummary
from ..irgspp_addon.importer.measure import PARTS, find_ends
from ..irgspp_addon.importer.object_sphere import cut_settings, find_sphere
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.properties import beside
from ..irgspp_addon.translations import translated
from .capture_state import capture_of
from .job_card import draw_last
from .photographs import parsed
from .run_state import resolved
from .sidebar import button, say, settings_column

SHOWN = 4  # photographs left out that the panel names


def draw_find_cameras(layout: bpy.types.UILayout, context: bpy.types.Context, dataset: Path, capture: CaptureSummary | None) -> None:
    """Draw the button that finds cameras, and its job.

    Args:
        layout: to draw into.
        context: of the panel.
        dataset: photographs without cameras, or a capture that is not finished.
        capture: summary of its capture.json; None without one.
    """
    if capture is not None:
        say(layout, context, "The cameras of these photographs are not all found yet; Find Cameras goes on.", icon="INFO")
    settings = settings_column(layout)
    settings.prop(context.scene.irgspp, "capture_marker")
    settings.prop(context.scene.irgspp, "capture_turntable")
    column = layout.column()
    column.scale_y = 1.3
    column.enabled = engine.status().usable
    button(column, "irgspp.capture", "Find Cameras", "CAMERA_DATA", directory=str(dataset))
    if expected := parsed(context.scene.irgspp.inspected).get("capture"):
        say(layout, context, translated("On the CPU: {estimate}.", estimate=expected["text"]), icon="TIME")
    place = resolved(dataset) or dataset
    draw_last(layout, context, "capture", place if capture else beside(place, "_capture"))


def draw_capture(layout: bpy.types.UILayout, context: bpy.types.Context, dataset: Path, capture: CaptureSummary | None) -> None:
    """Draw what a capture found and left out, and the buttons that show its report.

    Args:
        layout: to draw into.
        context: of the panel.
        dataset: folder of the capture.
        capture: summary of its capture.json; None without one.
    """
    if capture is None or capture.status != "done":
        return
    box = layout.box()
    for name, text in capture_rows(capture):
        row = box.split(factor=0.27)
        say(row, context, name)
        say(row, context, text, width=0.73)
    for name, reason in capture.left_out[:SHOWN]:
        say(box, context, translated("Left out {name}: {reason}", name=name, reason=reason), icon="ERROR")
    if len(capture.left_out) > SHOWN:
        more = len(capture.left_out) - SHOWN
        say(box, context, translated("and {count} more; the report names them", count=more), icon="BLANK1")
    draw_cut(box, context, dataset)
    draw_true_size(box, context, dataset)
    row = box.row(align=True)
    button(row, "wm.path_open", "Report", "URL", filepath=str(dataset / "report.html"))
    button(row, "irgspp.show_image", "Contact Sheet", "IMAGE_DATA", filepath=str(dataset / "contact_sheet.png"))


def draw_cut(layout: bpy.types.UILayout, context: bpy.types.Context, dataset: Path) -> None:
    """Draw the button that cuts another object out where the sphere was moved, and the job that does it.

    Args:
        layout: to draw into.
        context: of the panel.
        dataset: folder of a finished capture.
    """
    place = resolved(dataset) or dataset
    cuts = [job for job in jobs.all_jobs() if job.kind == "capture" and job.data.get("run") == str(place)]
    if cuts and cuts[0].state != "done":  # else it has nothing to tell that the rows do not
        draw_last(layout, context, "capture", place)
    if cuts and not cuts[0].finished:
        return
    if cut_settings(context.scene, dataset, capture_of(dataset)):
        column = layout.column()
        column.enabled = engine.status().usable
        button(column, "irgspp.capture", "Cut Out Again", "SPHERE", directory=str(dataset))


def draw_true_size(layout: bpy.types.UILayout, context: bpy.types.Context, dataset: Path) -> None:
    """Draw the buttons that measure two points and set their true distance.

    Args:
        layout: to draw into.
        context: of the panel.
        dataset: folder of a finished capture.
    """
    place = resolved(dataset) or dataset
    if find_sphere(context.scene, place) is None:
        return
    if len(find_ends(context.scene, place)) < len(PARTS):
        button(layout, "irgspp.place_ends", "Measure Two Points", "DRIVER_DISTANCE", directory=str(dataset))
        return
    column = settings_column(layout)
    column.prop(context.scene.irgspp, "capture_distance")
    row = layout.row()
    row.enabled = engine.status().usable and context.scene.irgspp.capture_distance > 0
    button(row, "irgspp.true_size", "Set True Size", "DRIVER_DISTANCE", directory=str(dataset))


def capture_rows(capture: CaptureSummary) -> list[tuple[str, str]]:
    """Return names and texts of what a capture found: photographs, masks, size."""
    used, masks = translated("{count} photographs", count=capture.used), str(capture.masked)
    if capture.left_out:
        used += translated(", {count} left out", count=len(capture.left_out))
    if capture.doubtful:
        masks += translated(", {count} doubtful: {names}", count=len(capture.doubtful), names=", ".join(capture.doubtful[:SHOWN]))
    if not capture.masked:
        masks = translated("none: the whole scene is reconstructed")
    size = "true, in metres" if capture.true_size else "unknown; a marker in the photographs or two measured points would tell"
    return [("Used", used), ("Masks", masks), ("Size", size)]
