# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of the engine as a background job, so that Blender does not wait for the import of torch."""

from __future__ import annotations

from ..engine import process as engine_process
from . import queue
from .job import Job


def check_in_background() -> Job | None:
    """Start a job that checks the engine, after which `engine.process.status()` has the result; None if no engine is installed."""
    if engine_process.status().state == "missing":
        return None
    python = engine_process.engine_python()
    for job in queue.all_jobs():
        if job.kind == "check" and not job.finished and job.data.get("python") == python:
            return job
    return queue.start("check", "Check engine", None, ["devices", "--json"], data={"python": python})


def being_installed() -> bool:
    """Return True while the managed engine is being installed, or waits for it."""
    return any(job.kind == "install" and not job.finished for job in queue.all_jobs())


def with_installation(engine: engine_process.Status) -> engine_process.Status:
    """Return the status that panels show: "installing" where the chosen engine does not work yet and is being installed.

    Args:
        engine: present status of the chosen engine.
    """
    if engine.usable or engine_process.engine_kind() != "MANAGED" or not being_installed():
        return engine
    return engine_process.Status("installing", "The engine is being installed")


def finish_check(job: Job) -> None:
    """Remember the result of a check and remove its job from the list."""
    if job.data.get("python") == engine_process.engine_python():  # else another engine has been chosen meanwhile
        errors = "\n".join(job.log_tail()) or job.error or ""
        engine_process.remember(engine_process.check_result(0 if job.state == "done" else 1, job.output(), errors))
    queue.forget(job)


def finish_installation(job: Job) -> None:
    """Remember the status of a newly installed engine, which its installer has already checked."""
    engine_process.forget_checks()
    if job.state == "done" and engine_process.engine_kind() == "MANAGED":
        engine_process.remember(engine_process.check_result(0, job.output(), ""))


ON_END = {"check": finish_check, "install": finish_installation}
