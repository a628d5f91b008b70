# SPDX-License-Identifier: GPL-3.0-or-later
"""Panel of the reconstruction: its options, its button, and its progress."""

from __future__ import annotations

from typing import Any

import bpy

from ..irgspp_addon.engine import process as engine
from ..irgspp_addon.importer.object_sphere import cut_settings, find_sphere, is_changed
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.translations import translated
from .capture_state import bare_photographs, capture_of
from .job_card import can_resume, current_job, draw_job
from .photographs import parsed
from .presets import draw_presets
from .run_state import resolved, run_state
from .sidebar import SidebarPanel, button, say, settings_column
from .steps import RECONSTRUCT, StepPanel, obstacle

STOPPED = ("running", "failed", "cancelled")  # states of a run folder that can be resumed; "running" where its process is gone


class IRGSPP_PT_reconstruct(StepPanel, SidebarPanel, bpy.types.Panel):
    """Panel that reconstructs an object with materials from photographs."""

    bl_label = "3 Reconstruct"
    bl_order = 4
    step = RECONSTRUCT

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options, the buttons, and the job."""
        layout, settings = self.layout, context.scene.irgspp
        draw_presets(layout, settings)
        column = settings_column(layout)
        for name in ("materials", "device"):
            column.prop(settings, name)
        job = current_job(settings.run_path())
        if job is None or job.finished:  # else the job's card has the buttons
            draw_start(layout, context, job)
        if job is not None:
            box = layout.box()
            if job.kind == "demo":
                box.label(text=job.title)  # it does not use the photographs chosen above
            draw_job(box, context, job, resume=False)


class IRGSPP_PT_reconstruct_more(SidebarPanel, bpy.types.Panel):
    """Panel of the run folder, the seed and single settings."""

    bl_label = "More"
    bl_parent_id = "IRGSPP_PT_reconstruct"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (Blender wants a plain set)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw these options."""
        column = settings_column(self.layout)
        for name in ("run", "seed", "overrides", "live_shape", "import_result"):
            column.prop(context.scene.irgspp, name)


def draw_start(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job | None) -> None:
    """Draw the buttons, and the reason where they are disabled.

    Args:
        layout: to draw into.
        context: of the panel.
        job: last reconstruction of this run folder; None without one.
    """
    settings = context.scene.irgspp
    status = run_state(settings.run_path()).status if settings.dataset else ""
    stopped, reason = status in STOPPED, obstacle(context, RECONSTRUCT)
    column = layout.column()
    column.enabled = not reason
    row = column.row()
    row.scale_y = 1.5
    if stopped and job is not None and can_resume(job):
        button(row, "irgspp.job_resume", "Resume", "FILE_REFRESH", job=job.id)
    elif stopped:
        button(row, "irgspp.reconstruct", "Resume", "FILE_REFRESH", resume=True)
    else:
        button(row, "irgspp.reconstruct", "Reconstruct Again" if status else "Reconstruct", "PLAY", overwrite=bool(status))
    if stopped:  # small, since it replaces what was done
        button(column, "irgspp.reconstruct", "Start Over", "FILE_NEW", overwrite=True)
    if reason:
        say(layout, context, reason, icon="INFO")
        return
    if status:
        text = "Start Over replaces the run in the folder." if stopped else "Reconstruct Again replaces the run in the folder."
        say(layout, context, text, icon="INFO")
    draw_sphere(layout, context, stopped)
    draw_estimate(layout, context)


def draw_sphere(layout: bpy.types.UILayout, context: bpy.types.Context, stopped: bool) -> None:
    """Draw what is reconstructed: photographs without cameras, or the contents of the object's sphere.

    Args:
        layout: to draw into.
        context: of the panel.
        stopped: the run in the folder can be resumed.
    """
    dataset = context.scene.irgspp.dataset_path()
    sphere = find_sphere(context.scene, resolved(dataset))
    if bare_photographs(dataset) is not None:
        say(layout, context, "The cameras are found first.", icon="INFO")
    elif sphere is not None and dataset is not None and cut_settings(context.scene, dataset, capture_of(dataset)):
        text = translated("What is inside the sphere {name} is cut out of the photographs first.", name=sphere.name)
        say(layout, context, text, icon="SPHERE")
        if stopped:
            say(layout, context, "Resume goes on with the object that the run began with.", icon="INFO")
    elif sphere is not None and is_changed(sphere):
        say(layout, context, translated("What is inside the sphere {name} is reconstructed.", name=sphere.name), icon="SPHERE")


def draw_estimate(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw how long the job will take on the CPU, where the photographs have been inspected and the time is known.

    Args:
        layout: to draw into.
        context: of the panel.
    """
    settings = context.scene.irgspp
    facts = parsed(settings.inspected)
    job = facts.get("jobs", {}).get(settings.preset)
    if not job:
        return
    text = "On the CPU, with the search for cameras: {estimate}." if "capture" in facts else "On the CPU: {estimate}."
    say(layout, context, translated(text, estimate=job["text"]), icon="TIME")
    if card := graphics_card(settings.device, engine.status().devices):
        say(layout, context, translated("{card} will be used; the estimate is for the processor.", card=card), icon="BLANK1")


def graphics_card(device: str, devices: dict[str, Any]) -> str:
    """Return the name of the graphics card that a job will run on; "" where it runs on the processor, or that is not known.

    Args:
        device: that is chosen, "auto", "cpu" or "cuda".
        devices: answer of `irgspp devices --json`; empty if the engine was not asked.
    """
    cards = devices.get("cuda", []) if "cuda can be used" in devices.get("notes", ()) else []
    if device == "cpu" or not (cards or device == "cuda"):
        return ""
    return cards[0]["name"] if cards else translated("A graphics card")


CLASSES = (IRGSPP_PT_reconstruct, IRGSPP_PT_reconstruct_more)
