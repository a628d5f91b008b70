# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of step 5: export for other programs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import bpy

from ..core.assets.options import AssetOptions
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.translations import translated
from .job_card import draw_last
from .shown_run import shown_run
from .sidebar import SidebarPanel, button, say, settings_column
from .steps import EXPORT, StepPanel, obstacle

FILES = (
    ("glTF for Most Programs (.glb)", "FILE_3D", ".glb"),
    ("USD (.usdc)", "FILE_3D", ".usdc"),
    ("USD in One File (.usdz)", "FILE_3D", ".usdz"),
    ("FBX (.fbx)", "FILE_3D", ".fbx"),
    ("OBJ (.obj)", "FILE_3D", ".obj"),
    ("Blender File (.blend)", "FILE_BLEND", ".blend"),
    ("Gaussian Splats (.ply)", "POINTCLOUD_DATA", ".ply"),
    ("Recovered Light (.exr)", "WORLD", ".exr"),
)


class IRGSPP_PT_export(StepPanel, SidebarPanel, bpy.types.Panel):
    """Panel that exports the result for other programs."""

    bl_label = "5 Export"
    bl_order = 6
    step = EXPORT

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the choices, a button for each kind of file, and the job, or why there is nothing to export yet."""
        if reason := obstacle(context, EXPORT):
            say(self.layout, context, reason, icon="INFO")
            return
        run, settings = shown_run(context), context.scene.irgspp
        column = settings_column(self.layout.column())
        for name in ("export_lods", "export_collision", "export_textures", "export_normal_map", "export_occlusion", "export_as_placed"):
            column.prop(settings, name)
        parts = settings.export_lods, settings.export_collision
        chosen = AssetOptions(*parts, settings.export_textures, settings.export_normal_map, occlusion=settings.export_occlusion)
        column = self.layout.column(align=True)
        for text, icon, suffix in FILES:
            words = asdict(chosen.fitting(suffix)) | {"as_placed": settings.export_as_placed}
            del words["transform"]  # which the operator finds in the scene
            file = str(run / f"{run.name}{suffix}") if run else ""
            button(column, "irgspp.export", text, icon, run=str(run), filepath=file, **words)
        draw_last(self.layout, context, "export", run)
        draw_exported(self.layout, run)


def draw_exported(layout: bpy.types.UILayout, run: Path | None) -> None:
    """Draw the button that shows the file which was exported last.

    Args:
        layout: to draw into.
        run: run folder.
    """
    done = (job for job in jobs.all_jobs() if job.kind == "export" and job.state == "done" and job.data.get("run") == str(run))
    file = next((Path(job.data["file"]) for job in done if "file" in job.data), None)
    if file is not None and file.is_file():
        button(layout, "wm.path_open", translated("Show {name}", name=file.name), "FILE_FOLDER", filepath=str(file.parent))


CLASSES = (IRGSPP_PT_export,)
