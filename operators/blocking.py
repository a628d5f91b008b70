# SPDX-License-Identifier: GPL-3.0-or-later
"""What operators share: keywords, errors in words, and waiting for a job as scripts do."""

import sys

import bpy

from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs.job import Job

SKIP = {"SKIP_SAVE"}
RUN = {
    "name": "Run Folder",
    "description": "Empty: that of the active object, or of the panel",
    "subtype": "DIR_PATH",
    "options": SKIP,
}
IMPORT = {"name": "Import When Done", "description": "Put the result into the scene", "default": True, "options": SKIP}
WAIT = {
    "name": "Wait",
    "description": "Return only once it is done, as scripts want; otherwise it is queued as a job",
    "default": True,
    "options": {"SKIP_SAVE", "HIDDEN"},
}


class Queued:
    """For operators with a keyword `wait` that buttons start: those get a job in the queue, scripts the result."""

    wait: bool

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.wait = bpy.app.background
        return self.execute(context)  # type: ignore[attr-defined]


def refuse(operator: bpy.types.Operator, error: Exception | str) -> set[str]:
    """Report an error, which scripts get as RuntimeError; one that another operator raised so is handed on."""
    operator.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
    return {"CANCELLED"}


def run_to_end(operator: bpy.types.Operator, job: Job) -> set[str]:
    """Block until the job has ended, its progress on stderr; a bad end is an error."""
    told = ""

    def show(job: Job) -> None:
        nonlocal told
        line = f"irgspp: {job.title}: {job.phase}" + (f" ({job.of} steps)" if job.of else "")
        if job.phase and line != told:
            told = line
            print(line, file=sys.stderr, flush=True)

    jobs.wait(job, watch=show)
    if job.state != "done":
        return refuse(operator, f"{job.title}: {job.error or job.state}")
    return {"FINISHED"}
