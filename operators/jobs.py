# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on one job: cancel, finish early, resume, forget, open its log."""

# pyright: reportInvalidTypeForm=false

from collections.abc import Callable

import bpy
from bpy.props import StringProperty

from ..core.errors import InputError, IrgsppError
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs import result_import
from ..irgspp_addon.jobs.job import Job
from ..irgspp_addon.jobs.timer import SHOWING
from ..irgspp_addon.windows import redraw
from .blocking import SKIP, refuse

NAMED = {"name": "Job", "description": "Id of the job in the list of jobs", "options": SKIP}


def _do(operator: bpy.types.Operator, work: Callable[[Job], object]) -> set[str]:
    try:
        job = jobs.find(operator.job)
        if job is None:
            raise InputError(f"job {operator.job!r}", "does not exist", "choose it in the list of jobs again")
        work(job)
    except IrgsppError as error:
        return refuse(operator, error)
    redraw(*SHOWING)
    return {"FINISHED"}


class IRGSPP_OT_job_cancel(bpy.types.Operator):
    """Stop the job and save its progress, so that it can be resumed. Press again to end it at once."""

    bl_idname = "irgspp.job_cancel"
    bl_label = "Cancel"

    job: StringProperty(**NAMED)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Cancel the job."""
        return _do(self, jobs.cancel)


class IRGSPP_OT_job_finish(bpy.types.Operator):
    """Stop optimising and continue with the present result, to the mesh and its materials."""

    bl_idname = "irgspp.job_finish"
    bl_label = "Finish Early"

    job: StringProperty(**NAMED)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Finish the present phase early."""
        return _do(self, jobs.finish_early)


class IRGSPP_OT_job_resume(bpy.types.Operator):
    """Continue a reconstruction that was stopped or has failed, from its last checkpoint."""

    bl_idname = "irgspp.job_resume"
    bl_label = "Resume"

    job: StringProperty(**NAMED)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Resume the reconstruction."""

        def resume(job: Job) -> None:
            result_import.renew_place(job, context.scene)
            jobs.resume(job)

        return _do(self, resume)


class IRGSPP_OT_job_forget(bpy.types.Operator):
    """Remove a finished job from the list; its results stay in their folder."""

    bl_idname = "irgspp.job_forget"
    bl_label = "Forget"

    job: StringProperty(**NAMED)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the job from the list."""
        return _do(self, jobs.forget)


class IRGSPP_OT_job_log(bpy.types.Operator):
    """Open the log with everything that the job printed."""

    bl_idname = "irgspp.job_log"
    bl_label = "Open Log"

    job: StringProperty(**NAMED)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Open the log."""
        return _do(self, _open_log)


def _open_log(job: Job) -> None:
    if not job.log.is_file():
        raise InputError(job.title, "has no log", "it may not have started yet")
    if bpy.app.background:
        print("\n".join(job.log_tail()))
    else:
        bpy.ops.wm.path_open(filepath=str(job.log))
