# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that operators share: keywords, error reports, and waiting for a job to end."""

import sys

import bpy

from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job

SKIP = {"SKIP_SAVE"}
RUN = {
    "name": "Run Folder",
    "description": "Folder of a reconstruction. Empty: that of the active object, or of the panel",
    "subtype": "DIR_PATH",
    "options": SKIP,
}
IMPORT = {
    "name": "Import When Done",
    "description": "Import the result into the scene when it is finished",
    "default": True,
    "options": SKIP,
}
WAIT = {
    "name": "Wait",
    "description": "Wait until it is finished, as scripts do; otherwise queue it as a job",
    "default": True,
    "options": {"SKIP_SAVE", "HIDDEN"},
}


class Queued:
    """Base of operators with a keyword `wait`: a button queues a job, a script gets the finished result."""

    wait: bool

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Run as a button does: queue a job, except in background mode.

        Args:
            context: of the button.
            event: ignored.
        """
        self.wait = bpy.app.background
        return self.execute(context)  # type: ignore[attr-defined]


def refuse(operator: bpy.types.Operator, error: Exception | str) -> set[str]:
    """Report an error and return CANCELLED; Blender raises it in scripts as RuntimeError.

    Args:
        operator: that failed.
        error: exception or text; the prefix of an error that another operator reported is removed.
    """
    operator.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
    return {"CANCELLED"}


def run_to_end(operator: bpy.types.Operator, job: Job) -> set[str]:
    """Wait until the job has ended, and print its phases to stderr.

    Args:
        operator: that started the job; it reports an error where the job did not succeed.
        job: in the queue.
    """
    printed = ""

    def show(job: Job) -> None:
        nonlocal printed
        line = f"irgspp: {job.title}: {job.phase}" + (f" ({job.of} steps)" if job.of else "")
        if job.phase and line != printed:
            printed = line
            print(line, file=sys.stderr, flush=True)

    jobs.wait(job, watch=show)
    if job.state != "done":
        return refuse(operator, f"{job.title}: {job.error or job.state}")
    return {"FINISHED"}
