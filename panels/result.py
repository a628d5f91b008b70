# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of step 4: the object, its material and cameras, and baking again."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..irgspp_addon.comparison import view_colours
from ..irgspp_addon.comparison.photograph import shown_photograph
from ..irgspp_addon.importer.arrangement import camera_label, cameras_shown, is_imported_camera
from ..irgspp_addon.importer.confidence_view import has_confidence
from ..irgspp_addon.importer.displacement import has_displacement
from ..irgspp_addon.importer.materials import available_sources
from ..irgspp_addon.shared_properties import TEXTURE_SIZES
from ..irgspp_addon.translations import translated
from .asset_words import faces_text, mesh_text, size_text, texture_text
from .job_card import draw_last
from .run_state import RunState, run_state
from .shown_run import object_of_run, shown_run
from .sidebar import SidebarPanel, button, say, settings_column
from .steps import LOOK, FinishedRunPanel, StepPanel, obstacle


class IRGSPP_PT_result(StepPanel, SidebarPanel, bpy.types.Panel):
    """Panel of the reconstructed object, with relighting below it."""

    bl_label = "4 Look and Relight"
    bl_order = 5
    step = LOOK

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the object and its quality, or how to get one."""
        layout, run = self.layout, shown_run(context)
        state = run_state(run)
        if run is not None and state.status == "" and object_of_run(context.scene, run) is not None:
            text = translated("The run folder {run} is not there any more. Open it at its new place.", run=run)
            say(layout, context, text, icon="ERROR")
            button(layout, "irgspp.import_run", "Open a Run", "FILE_FOLDER")
            return
        if run is None or state.status == "":
            say(layout, context, obstacle(context, LOOK), icon="INFO")
            button(layout, "irgspp.import_run", "Open a Run", "FILE_FOLDER")
            return
        if state.status != "done":
            say(layout, context, UNFINISHED[state.status], icon="INFO")
            return
        thing = object_of_run(context.scene, run)
        draw_object(layout, context, run, thing)
        draw_texture_sizes(layout, run, state)
        draw_cameras(layout, context)
        draw_quality(layout, context, state)
        draw_files(layout, run)


class IRGSPP_PT_bake(FinishedRunPanel, SidebarPanel, bpy.types.Panel):
    """Panel that bakes textures again, at another size or onto an edited mesh."""

    bl_label = "Bake Again"
    bl_parent_id = "IRGSPP_PT_result"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options, the button and the job."""
        settings, edited = context.scene.irgspp, context.scene.irgspp.edited_mesh
        column = settings_column(self.layout)
        for name in ("texture_size", "texture_bits"):
            column.row().prop(settings, name, expand=True)
        column.prop(settings, "udim_tiles")
        quads = 0 if edited else settings.bake_quads  # an edited mesh is baked as it is
        triangles = 0 if edited or quads else settings.triangles
        for name, enabled in (("triangles", edited is None and not quads), ("bake_quads", edited is None)):
            row = column.row()
            row.enabled = enabled
            row.prop(settings, name)
        column.prop(settings, "edited_mesh")
        column.prop(settings, "bake_height")
        say(column, context, mesh_text(triangles, quads, edited is not None), icon="INFO")
        button(
            self.layout,
            "irgspp.bake",
            "Bake",
            "TEXTURE",
            run=str(shown_run(context)),
            size=int(settings.texture_size),
            bits=settings.texture_bits,
            udim=settings.udim_tiles,
            triangles=triangles,
            quads=quads,
            mesh=edited.name if edited else "",
            height=settings.bake_height,
        )
        draw_last(self.layout, context, "bake", shown_run(context))


UNFINISHED = {
    "running": "Not finished yet.",
    "failed": "The reconstruction failed; see above.",
    "cancelled": "The reconstruction was stopped; it can be resumed.",
    "broken": "The run folder can't be read.",
}


def draw_object(layout: bpy.types.UILayout, context: bpy.types.Context, run: Path, thing: bpy.types.Object | None) -> None:
    """Draw the object in the scene, or the button that imports it.

    Args:
        layout: to draw into.
        context: of the panel.
        run: run folder.
        thing: mesh object of the run; None where it is not in the scene.
    """
    settings = context.scene.irgspp
    if thing is not None:
        row = layout.row(align=True)
        row.prop(thing, "name", text="", icon="OUTLINER_OB_MESH")
        row.prop(thing, "hide_viewport", text="", emboss=True)
        layout.label(text=f"{faces_text(thing.data)}, {texture_text(thing)}")
        material = thing.active_material
        if material is not None and len(available_sources(material)) > 1:
            column = settings_column(layout)
            column.row().prop(material, "irgspp_source", expand=True)
        if material is not None and has_confidence(material):
            layout.prop(material, "irgspp_show_confidence")
        if material is not None and has_displacement(material):
            layout.prop(material, "irgspp_displace")
    button(
        layout,
        "irgspp.import_run",
        "Import Again" if thing else "Import Result",
        "IMPORT",
        directory=str(run),
        material=settings.source,
        pack=settings.pack,
    )


def draw_texture_sizes(layout: bpy.types.UILayout, run: Path, state: RunState) -> None:
    """Draw a button for each texture size that the run's bake gives without baking; none where it gives its own size alone.

    Args:
        layout: to draw into.
        run: run folder.
        state: of the run.
    """
    baked, shown = state.textures.get("baked", 0), state.textures.get("size", 0)
    sizes = sorted({*(int(size) for size, *_ in TEXTURE_SIZES if int(size) < baked), baked})
    if len(sizes) < 2:
        return
    row = layout.row(align=True)
    row.label(text="Textures")
    for size in sizes:
        pressed = row.operator("irgspp.bake", text=size_text(size), depress=size == shown)
        pressed.run, pressed.size = str(run), size


def draw_cameras(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the buttons that look through the cameras one after the other, the comparison, and the switch that shows the cameras.

    Args:
        layout: to draw into.
        context: of the panel.
    """
    if not any(is_imported_camera(thing) for thing in context.scene.objects):
        return
    row, shown = layout.row(align=True), cameras_shown(context.scene)
    button(row, "irgspp.step_photograph", "", "TRIA_LEFT", step=-1)
    through = context.scene.camera if is_imported_camera(context.scene.camera) else None
    photograph = shown_photograph(context.scene)
    button(row, "irgspp.step_photograph", camera_label(through) if through else "Photographs", step=1)
    button(row, "irgspp.step_photograph", "", "TRIA_RIGHT", step=1)
    if photograph is not None:
        draw_comparison(layout, context)
    button(layout, "irgspp.show_cameras", "Hide Cameras" if shown else "Show Cameras", "CAMERA_DATA", show=not shown)


def draw_comparison(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the slider between photograph and result, and the button that makes their colours comparable.

    Args:
        layout: to draw into.
        context: of the panel, whose scene is seen through a photograph's camera.
    """
    scene = context.scene
    layout.row().prop(scene, "irgspp_comparison", expand=True)
    layout.prop(scene, "irgspp_border" if scene.irgspp_comparison == "split" else "irgspp_photograph", text="Photograph", slider=True)
    if before := view_colours.kept_transform(scene):
        button(layout, "irgspp.comparison_colours", translated("Restore {view}", view=before), "LOOP_BACK", restore=True)
    elif not view_colours.are_plain(scene):
        text = translated("{view} changes the colours of the result, not of the photograph.", view=scene.view_settings.view_transform)
        say(layout, context, text, icon="INFO")
        button(layout, "irgspp.comparison_colours", "Compare under Standard", "COLOR")


def draw_files(layout: bpy.types.UILayout, run: Path) -> None:
    """Draw the buttons that show the run folder and its contact sheet.

    Args:
        layout: to draw into.
        run: run folder.
    """
    row, sheet = layout.row(align=True), run / "contact_sheet.png"
    button(row, "wm.path_open", "Open Folder", "FILE_FOLDER", filepath=str(run))
    if sheet.is_file():
        button(row, "irgspp.show_image", "Contact Sheet", "IMAGE_DATA", filepath=str(sheet))


def draw_quality(layout: bpy.types.UILayout, context: bpy.types.Context, state: RunState) -> None:
    """Draw the PSNR of the views, and the parts that were skipped.

    Args:
        layout: to draw into.
        context: of the panel.
        state: of the run.
    """
    known = state.training.get("test_radiance_psnr"), state.training.get("psnr")
    if known[0] is not None:
        layout.label(text=translated("Test views: {value} dB PSNR", value=f"{known[0]:.1f}"))
    elif known[1] is not None:
        layout.label(text=translated("Training views: {value} dB PSNR", value=f"{known[1]:.1f}"))
    for line in state.skipped:
        say(layout, context, line, icon="INFO")


CLASSES = (IRGSPP_PT_result, IRGSPP_PT_bake)
