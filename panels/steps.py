# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of the work: which are done, which one is next, and why one can't be done yet."""

from __future__ import annotations

import bpy

from ..irgspp_addon.engine import process as engine
from .capture_state import cameras_missing, capture_of, problem_of
from .job_card import current_job
from .run_state import run_state
from .shown_run import is_finished

PHOTOGRAPHS, CAMERAS, RECONSTRUCT, LOOK, EXPORT = range(1, 6)  # numbers in the headers of the panels
ICONS = {"done": "CHECKMARK", "next": "RADIOBUT_ON", "open": "RADIOBUT_OFF", "later": "RADIOBUT_OFF"}


class StepPanel:
    """Part of the panels of steps: the header tells whether the step is done, the next one, or can't be done yet."""

    step: int  # its number

    def draw_header(self, context: bpy.types.Context) -> None:
        """Draw the icon of the step's state."""
        state, layout = step_state(context, self.step), self.layout  # pyright: ignore[reportAttributeAccessIssue]
        layout.active = state != "later"
        layout.label(text="", icon=ICONS[state])


class FinishedRunPanel:
    """Part of panels that are shown where there is a finished run."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return True where there is a finished run."""
        return is_finished(context)


def step_state(context: bpy.types.Context, step: int) -> str:
    """Return the state of a step: "done", "next", "open" (it can be done), or "later" (it can't be done yet).

    Args:
        context: of the panel.
        step: number of the step.
    """
    done = done_steps(context)
    if step == next_step(context, done):
        return "next"
    if step in done:
        return "done"
    return "later" if obstacle(context, step) else "open"


def next_step(context: bpy.types.Context, done: set[int]) -> int:
    """Return the step that comes after the last one that is done, or the reconstruction while it runs.

    Args:
        context: of the panel.
        done: numbers of the steps that are done.
    """
    job = current_job(context.scene.irgspp.run_path())
    return RECONSTRUCT if job is not None and not job.finished else max(done, default=0) + 1


def done_steps(context: bpy.types.Context) -> set[int]:
    """Return the numbers of the steps that are done; looking, relighting and exporting never are."""
    settings = context.scene.irgspp
    dataset = settings.dataset_path()
    if dataset is None:
        return {RECONSTRUCT} if is_finished(context) else set()
    if problem_of(dataset):
        return set()
    if run_state(settings.run_path()).status == "done":  # which found cameras that were missing
        return {PHOTOGRAPHS, CAMERAS, RECONSTRUCT}
    return {PHOTOGRAPHS} if cameras_missing(dataset, capture_of(dataset)) else {PHOTOGRAPHS, CAMERAS}


def obstacle(context: bpy.types.Context, step: int) -> str:
    """Return why a step can't be done yet, in a sentence; "" where it can.

    Args:
        context: of the panel.
        step: number of the step.
    """
    if step in (LOOK, EXPORT):
        return "" if is_finished(context) else "First reconstruct, or open a run."
    if step in (CAMERAS, RECONSTRUCT) and PHOTOGRAPHS not in done_steps(context):
        return "First choose photographs."
    if step in (CAMERAS, RECONSTRUCT) and not engine.status().usable:
        return "First set up the engine above."
    return ""
