# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that operators share: keywords, error reports, start by a button, and waiting for a job to end."""

import sys
from collections.abc import Callable
from functools import wraps
from typing import Any

import bpy

from ..core.errors import IrgsppError
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


class StartedByButton:
    """Base of operators whose button starts work and returns at once, by `start`; in scripts, `execute` returns when it is finished."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the work as a button does, except in background mode.

        Args:
            context: of the button or menu.
            event: ignored.
        """
        return self.execute(context) if bpy.app.background else self.start(context)  # type: ignore[attr-defined]


Run = Callable[[Any, bpy.types.Context], set[str]]  # an operator's `execute`


def refusing(*others: type[Exception]) -> Callable[[Run], Run]:
    """Return a decorator of an operator's `execute`: an IrgsppError is reported, and the operator is cancelled.

    Args:
        *others: other errors that are reported, such as RuntimeError, which Blender's own operators raise.
    """

    def decorate(execute: Run) -> Run:
        @wraps(execute)
        def reporting(self: Any, context: bpy.types.Context) -> set[str]:  # Blender counts the arguments
            try:
                return execute(self, context)
            except (IrgsppError, *others) as error:
                return refuse(self, error)

        return reporting

    return decorate


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
