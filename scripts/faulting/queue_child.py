# SPDX-License-Identifier: GPL-3.0-or-later
"""Many jobs through the extension's queue, in a process that is Blender: `python queue_child.py JOBS FOLDER`; prints JSON.

$BLENDER_USER_RESOURCES is the folder of the extension's own files.
"""

from __future__ import annotations

import json
import random
import runpy
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import bpy  # before anything of ours
import psutil

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 900.0  # seconds that a batch may take
KINDS = ("render", "reconstruct", "export")  # the last does not wait for the others
COUNTER = Path(__file__).with_name("counter.py")


def main(count: int, folder: Path) -> dict[str, Any]:
    """Queue jobs in batches, cancel some, wait for all, and return what is left of them.

    Args:
        count: number of jobs.
        folder: folder of the runs.
    """
    runpy.run_path(str(ROOT / "irgspp_addon" / "launch.py"))["mount"](ROOT)
    from irgspp.irgspp_addon.jobs import queue as jobs
    from irgspp.irgspp_addon.jobs import timer as job_timer

    temporary = folder / "temporary"
    temporary.mkdir()
    tempfile.tempdir = str(temporary)
    job_timer.register()
    chance, states, seen = random.Random(0), {}, []
    work(jobs, job_timer, folder, 20, chance, {})  # warm up: modules are loaded now
    before = resource_usage()
    for _ in range(0, count, 20):
        work(jobs, job_timer, folder, min(20, count), chance, states)
        seen.append(resource_usage()["memory"])
    after = resource_usage()
    notes = len([p for p in jobs.jobs_folder().iterdir() if p.is_dir()])
    remembered = len(jobs.all_jobs())
    job_timer.unregister()
    left = {"notes": notes, "remembered": remembered, "history": jobs.HISTORY, "temporary": len(list(temporary.iterdir()))}
    left |= {"sessions": len(list(jobs.jobs_folder().glob("*.session"))), "timer": bpy.app.timers.is_registered(job_timer._tick)}
    return {"before": before, "after": after, "memory": seen, "states": states, **left}


def work(jobs: Any, timer: Any, folder: Path, count: int, chance: random.Random, states: dict[str, int]) -> None:
    """Run a batch of jobs and return when all have ended; about 40 % are cancelled at random moments, some of these twice.

    Args:
        jobs: module of the queue.
        timer: module of the queue's timer.
        folder: folder of the runs.
        count: number of jobs.
        chance: random numbers.
        states: final states with their counts, which the jobs are added to.
    """
    made = []
    for i in range(count):
        kind = chance.choice(KINDS)
        run = folder / f"run{i}" if kind == "reconstruct" else None
        made.append(jobs.start(kind, f"job {i}", run, [str(chance.randrange(1, 6))], program=str(COUNTER)))
    cancels = {job.id: chance.choice((1, 2)) for job in made if chance.random() < 0.4}  # a second cancel ends a job at once
    end = time.monotonic() + TIMEOUT
    while not all(job.finished for job in made):
        timer._tick()
        for job in made:
            if cancels.get(job.id, 0) and chance.random() < 0.03:
                jobs.cancel(job)
                cancels[job.id] -= 1
        if time.monotonic() > end:
            raise TimeoutError([(job.title, job.state) for job in made])
        time.sleep(0.005)
    for job in made:
        states[job.state] = states.get(job.state, 0) + 1


def resource_usage() -> dict[str, int]:
    """Return this process's memory in bytes, open files, threads, and child processes (zombies too)."""
    process = psutil.Process()
    handles = process.num_handles() if sys.platform == "win32" else process.num_fds()
    memory = process.memory_info().rss
    return {"memory": memory, "handles": handles, "threads": process.num_threads(), "children": len(process.children(recursive=True))}


if __name__ == "__main__":
    print(json.dumps(main(int(sys.argv[1]), Path(sys.argv[2]))), flush=True)
