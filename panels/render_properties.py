# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels of the Render tab of the Properties editor while IRGS++ is the scene's render engine: sampling and film."""

from __future__ import annotations

import bpy

from ..irgspp_addon.relight.render_engine import ENGINE
from .sidebar import settings_column


class RenderPanel:
    """Base of panels in the Render tab, shown while IRGS++ is the scene's render engine."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True while IRGS++ is the render engine."""
        return context.engine == ENGINE


class IRGSPP_PT_render_sampling(RenderPanel, bpy.types.Panel):
    """Panel of the light and the samples of an image."""

    bl_label = "Sampling"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings that the sidebar's panel Relight has too."""
        column = settings_column(self.layout)
        for name in ("relight_samples", "relight_denoise", "relight_backend", "use_world", "use_lamps", "ground_shadow"):
            column.prop(context.scene.irgspp, name)


class IRGSPP_PT_render_film(RenderPanel, bpy.types.Panel):
    """Panel of the background."""

    bl_label = "Film"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the switch between the World and a transparent background."""
        settings_column(self.layout).prop(context.scene.render, "film_transparent", text="Transparent")


CLASSES = (IRGSPP_PT_render_sampling, IRGSPP_PT_render_film)
