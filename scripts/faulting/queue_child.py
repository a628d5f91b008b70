# SPDX-License-Identifier: GPL-3.0-or-later
"""Many jobs through the extension's queue, in a process that is Blender: `python queue_child.py JOBS FOLDER`; figures as JSON.

$BLENDER_USER_RESOURCES says where the extension's own files are to be.
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
PATIENCE = 900.0  # seconds without a job's end
KINDS = ("render", "reconstruct", "export")  # the last does not wait for the others
COUNTER = Path(__file__).with_name("counter.py")


def main(count: int, folder: Path) -> dict[str, Any]:
    """Queue so many jobs in batches, cancel some, wait for all; what is left of them."""
    runpy.run_path(str(ROOT / "irgspp_addon" / "launch.py"))["mount"](ROOT)
    from irgspp.irgspp_addon.jobs import queue as jobs
    from irgspp.irgspp_addon.jobs import timer as job_timer

    temporary = folder / "temporary"
    temporary.mkdir()
    tempfile.tempdir = str(temporary)
    job_timer.register()
    chance, states, seen = random.Random(0), {}, []
    work(jobs, job_timer, folder, 20, chance, {})  # what is loaded once is loaded now
    before = figures()
    for _ in range(0, count, 20):
        work(jobs, job_timer, folder, min(20, count), chance, states)
        seen.append(figures()["memory"])
    after = figures()
    notes = len([p for p in jobs.jobs_folder().iterdir() if p.is_dir()])
    remembered = len(jobs.all_jobs())
    job_timer.unregister()
    left = {"notes": notes, "remembered": remembered, "history": jobs.HISTORY, "temporary": len(list(temporary.iterdir()))}
    left |= {"sessions": len(list(jobs.jobs_folder().glob("*.session"))), "timer": bpy.app.timers.is_registered(job_timer._tick)}
    return {"before": before, "after": after, "memory": seen, "states": states, **left}


def work(jobs: Any, timer: Any, folder: Path, count: int, chance: random.Random, states: dict[str, int]) -> None:
    """Some jobs at once, about 40 % of them cancelled at random moments, some of these twice; returns when all have ended."""
    made = []
    for i in range(count):
        kind = chance.choice(KINDS)
        run = folder / f"run{i}" if kind == "reconstruct" else None
        made.append(jobs.start(kind, f"job {i}", run, [str(chance.randrange(1, 6))], program=str(COUNTER)))
    cancels = {job.id: chance.choice((1, 2)) for job in made if chance.random() < 0.4}  # asked twice, a job is ended at once
    end = time.monotonic() + PATIENCE
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


def figures() -> dict[str, int]:
    """What this process holds: bytes of memory, open files, threads, child processes (dead ones that nobody has waited for, too)."""
    process = psutil.Process()
    handles = process.num_handles() if sys.platform == "win32" else process.num_fds()
    memory = process.memory_info().rss
    return {"memory": memory, "handles": handles, "threads": process.num_threads(), "children": len(process.children(recursive=True))}


if __name__ == "__main__":
    print(json.dumps(main(int(sys.argv[1]), Path(sys.argv[2]))), flush=True)
