# SPDX-License-Identifier: GPL-3.0-or-later
"""The object under the scene's World: a picture that follows what is changed."""

from __future__ import annotations

import bpy

from .result import shown_run
from .run_state import run_state
from .sidebar import SidebarPanel, button, say, settings_column


class IRGSPP_PT_relight(SidebarPanel, bpy.types.Panel):
    """The object in another light"""

    bl_label = "Relight"
    bl_order = 4

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings, run = self.layout, context.scene.irgspp, shown_run(context)
        if run_state(run).status != "done":
            say(layout, context, "Needs a finished reconstruction.", icon="INFO")
            return
        layout.template_ID(context.scene, "world", new="world.new")
        column = settings_column(layout)
        for name in ("use_world", "relight_eye", "relight_samples", "preview_resolution", "relight_denoise", "relight_backend"):
            column.prop(settings, name)
        column = layout.column()
        column.scale_y = 1.3
        button(
            column,
            "irgspp.relight_preview",
            "Preview",
            "SHADING_RENDERED",
            run=str(run),
            samples=settings.relight_samples,
            denoise=settings.relight_denoise,
            backend=settings.relight_backend,
            resolution=settings.preview_resolution,
        )


CLASSES = (IRGSPP_PT_relight,)
