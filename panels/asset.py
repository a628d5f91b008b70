# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel that marks the object as an asset."""

from __future__ import annotations

import bpy

from ..irgspp_addon.importer.asset_collection import marked_asset
from .shown_run import object_of_run, shown_run
from .sidebar import SidebarPanel, button, say
from .steps import FinishedRunPanel


class IRGSPP_PT_asset(FinishedRunPanel, SidebarPanel, bpy.types.Panel):
    """Panel of the object as an asset of Blender's Asset Browser."""

    bl_label = "Asset"
    bl_parent_id = "IRGSPP_PT_export"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw what the asset is called and who made it, or how to make one."""
        run = shown_run(context)
        thing = object_of_run(context.scene, run)
        if thing is None or run is None:
            say(self.layout, context, "The object is not in this scene.", icon="INFO")
            return
        settings, block = context.scene.irgspp, marked_asset(thing)
        asset = block.asset_data if block is not None else None
        if block is not None and asset is not None:
            parts = [block.name, asset.author, asset.license, ", ".join(tag.name for tag in asset.tags)]
            say(self.layout, context, " | ".join(part for part in parts if part), icon="ASSET_MANAGER")
        text = "Change Asset" if asset is not None else "Mark as Asset"
        parts = {"lods": settings.export_lods, "collision": settings.export_collision}
        button(self.layout, "irgspp.mark_asset", text, "ASSET_MANAGER", run=str(run), **parts)


CLASSES = (IRGSPP_PT_asset,)
