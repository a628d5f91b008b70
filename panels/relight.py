# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of relighting under the scene's World: preview, renders, and files."""

from __future__ import annotations

import bpy

from ..irgspp_addon.importer.run_frame import ALBEDO_SCALE
from ..irgspp_addon.importer.run_root import recovered_light
from ..irgspp_addon.relight import preview
from ..irgspp_addon.relight.animation import animation
from ..irgspp_addon.relight.ground import added_plane
from ..irgspp_addon.relight.left_out import left_out
from ..irgspp_addon.relight.live_image import follower_of
from ..irgspp_addon.relight.render_engine import ENGINE
from ..irgspp_addon.translations import translated
from ..irgspp_addon.world.hdri_library import unreadable_folder
from ..irgspp_addon.world.light_controls import UP, light_controls
from .job_card import draw_last
from .shown_run import object_of_run, shown_run
from .sidebar import SidebarPanel, button, say, settings_column
from .steps import FinishedRunPanel

THUMBNAIL = 6.0  # height of the chosen HDRI's thumbnail, rows of buttons
OPTIONS = (
    "use_world",
    "use_lamps",
    "ground_shadow",
    "relight_eye",
    "preview_resolution",
    "relight_samples",
    "relight_denoise",
    "relight_backend",
)


class IRGSPP_PT_relight(FinishedRunPanel, SidebarPanel, bpy.types.Panel):
    """Panel that relights the object."""

    bl_label = "Relight"
    bl_parent_id = "IRGSPP_PT_result"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the World, the options, the preview and the render engine."""
        layout, settings = self.layout, context.scene.irgspp
        draw_light(layout, context)
        column = settings_column(layout)
        for name in OPTIONS:
            column.prop(settings, name)
        draw_shadow_catcher(layout, context)
        thing = object_of_run(context.scene, shown_run(context))
        if thing is not None and ALBEDO_SCALE in thing:  # imports of older versions lack it
            column.prop(thing, f'["{ALBEDO_SCALE}"]', text="Albedo Scale")
        draw_preview(layout, context)
        draw_engine(layout, context)
        if missing := left_out(context.scene, context.view_layer, shown_run(context)):
            text = translated("{missing}. IRGS++ draws one reconstruction under World and lamps.", missing=missing)
            say(layout, context, text, icon="INFO")


class IRGSPP_PT_relight_files(FinishedRunPanel, SidebarPanel, bpy.types.Panel):
    """Panel that writes relit images and environment maps as files."""

    bl_label = "Files"
    bl_parent_id = "IRGSPP_PT_relight"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the buttons and the job."""
        column, settings = self.layout.column(align=True), context.scene.irgspp
        button(
            column,
            "irgspp.render_views",
            "Photographed Views, Relit",
            "RENDER_RESULT",
            run=str(shown_run(context)),
            samples=str(settings.relight_samples),
            denoise=settings.relight_denoise,
            backend=settings.relight_backend,
            use_world=settings.use_world,
            use_lamps=settings.use_lamps,
        )
        button(column, "irgspp.world_to_map", "World as Light Map", "WORLD")
        draw_last(self.layout, context, "render", shown_run(context))
        draw_animation(self.layout, context)


def draw_animation(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the buttons that render an animation of the light, or its progress and the button that stops it, and any error.

    Args:
        layout: to draw into.
        context: of the panel.
    """
    last = animation()
    if last is not None and not last.ended:
        layout.progress(factor=last.fraction, text=last.text)
        button(layout, "irgspp.stop_animation", "Stop Animation", "X")
        return
    column = layout.column(align=True)
    button(column, "irgspp.render_animation", "Animation", "RENDER_ANIMATION")
    button(column, "irgspp.render_animation", "One Turn of the Light", "FILE_REFRESH", turn=True)
    if last is not None and last.folder is not None:
        button(column, "wm.path_open", translated("Show Frames in {name}", name=last.folder.name), "FILE_FOLDER", filepath=str(last.folder))
    if last is not None and last.error:
        column = layout.column()
        column.alert = True
        say(column, context, last.error, icon="ERROR")


def draw_light(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the World, its image or colour, rotation and strength, and the buttons that choose another light.

    Args:
        layout: to draw into.
        context: of the panel.
    """
    world, lit = context.scene.world, context.scene.irgspp.use_world
    column = layout.column()
    column.enabled = lit
    column.template_ID(context.scene, "world", new="world.new")
    layout.template_icon_view(context.scene, "irgspp_hdri", show_labels=True, scale=THUMBNAIL)
    if (folder := unreadable_folder()) is not None:
        text = translated("The HDRI folder {folder} is not there; choose it again in the preferences.", folder=folder)
        say(layout, context, text, icon="ERROR")
    row = layout.row(align=True)
    button(row, "irgspp.open_hdri", "Open HDRI", "FILE_IMAGE")
    light = recovered_light(shown_run(context))
    if light is not None and light != world:
        button(row, "irgspp.use_recovered_light", "Recovered Light", "LIGHT_SUN", run=str(shown_run(context)))
    controls, rows = light_controls(world), settings_column(layout)
    rows.enabled = lit
    if controls.image is not None:
        say(rows, context, controls.image.name, icon="IMAGE_DATA")
    if controls.rotation is not None:
        row = rows.row(align=True)
        row.prop(controls.rotation, "default_value", index=UP, text="Rotation")
        button(row, "irgspp.rotate_light", "", "CON_ROTLIKE")
    if controls.colour is not None:
        rows.prop(controls.colour, "default_value", text="Colour")
    if controls.strength is not None:
        rows.prop(controls.strength, "default_value", text="Strength")


def draw_shadow_catcher(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the button that adds or removes the plane that catches the object's shadow, and what EEVEE makes of it.

    Args:
        layout: to draw into.
        context: of the panel.
    """
    if added_plane(context.scene) is None:
        button(layout, "irgspp.shadow_catcher", "Add Shadow-Catcher Plane", "MESH_PLANE", run=str(shown_run(context)))
        return
    button(layout, "irgspp.shadow_catcher", "Remove Shadow-Catcher Plane", "X", remove=True)
    if context.scene.render.engine.startswith("BLENDER_EEVEE"):
        say(layout, context, "EEVEE renders the plane itself: only IRGS++ and Cycles know shadow catchers.", icon="INFO")


def draw_preview(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the button that starts the preview, or its progress and the button that stops it, and any error.

    Args:
        layout: to draw into.
        context: of the panel.
    """
    follower = follower_of(preview.CHANNEL)
    if follower is None or follower.ended:
        column = layout.column()
        column.scale_y = 1.3
        button(column, "irgspp.relight_preview", "Preview", "SHADING_RENDERED")
    else:
        if not follower.failed:
            layout.progress(factor=1.0 if follower.done else follower.share, text="Up to date" if follower.done else follower.message)
        button(layout, "irgspp.relight_stop", "Stop Preview", "X")
    if follower is not None and follower.failed and not (follower.ended and follower.outdated):
        column = layout.column()
        column.alert = True
        say(column, context, follower.message, icon="ERROR")


def draw_engine(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the button that makes IRGS++ the render engine of the scene.

    Args:
        layout: to draw into.
        context: of the panel.
    """
    if context.scene.render.engine == ENGINE:
        say(layout, context, "F12 and Rendered shading use IRGS++.", icon="CHECKMARK")
    else:
        button(layout, "wm.context_set_enum", "Use for F12 and Rendered View", "SCENE", data_path="scene.render.engine", value=ENGINE)


CLASSES = (IRGSPP_PT_relight, IRGSPP_PT_relight_files)
