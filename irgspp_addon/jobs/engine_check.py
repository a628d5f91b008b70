# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine checked by a job, so that Blender needs not wait for torch."""

from __future__ import annotations

from ..engine import process as engine
from . import queue as jobs
from .job import Job


def check_in_background() -> Job | None:
    """Ask the engine what it is; `engine.status()` says it soon after. None where there is nothing to ask."""
    if engine.status().state == "missing":
        return None
    for job in jobs.all_jobs():
        if job.kind == "check" and not job.finished:
            return job
    return jobs.start("check", "Check engine", None, ["devices", "--json"], data={"python": engine.engine_python()})


def take_check(job: Job) -> None:
    """Remember what a check found; nobody wants to see that job afterwards."""
    if job.data.get("python") == engine.engine_python():  # else another engine was chosen meanwhile
        said = "\n".join(job.log_tail()) or job.error or ""
        engine.remember(engine.judged(0 if job.state == "done" else 1, job.output(), said))
    jobs.forget(job)


def take_installation(job: Job) -> None:
    """A new engine is there: the installer has asked it already."""
    engine.forget_checks()
    if job.state == "done" and engine.engine_kind() == "MANAGED":
        engine.remember(engine.judged(0, job.output(), ""))


ON_END = {"check": take_check, "install": take_installation}
