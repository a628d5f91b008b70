# SPDX-License-Identifier: GPL-3.0-or-later
"""Long queues of jobs in Blender: no processes, files or memory are left after them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from stresses.case import Measured

from .cases import case_of

case = case_of("long_queue")
CHILD = Path(__file__).with_name("queue_child.py")
GROWTH = 4.0  # MB that Blender's memory may grow


def check_queue(measured: Measured, count: int) -> None:
    """Run jobs through the queue and check what they leave.

    Args:
        measured: result of the case.
        count: number of jobs.
    """
    with tempfile.TemporaryDirectory(prefix="irgspp-faults-") as folder:
        environment = {**os.environ, "BLENDER_USER_RESOURCES": os.path.join(folder, "user")}
        command = [sys.executable, str(CHILD), str(count), folder]
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    measured.holds(f"the queue ends well: {done.stderr.strip()[-300:]}", done.returncode == 0)
    if done.returncode:
        return
    report = json.loads(done.stdout.strip().splitlines()[-1])
    before, after = report["before"], report["after"]
    measured.note(f"{sum(report['states'].values())} jobs: {', '.join(f'{n} {state}' for state, n in sorted(report['states'].items()))}")
    measured.holds(f"only done and cancelled, not {report['states']}", set(report["states"]) <= {"done", "cancelled"})
    for what in ("handles", "threads", "children"):
        measured.at_most(f"{what} more than {before[what]}:", after[what] - before[what], 0)
    measured.at_most(f"growth of {before['memory'] / 1e6:.0f} MB:", (after["memory"] - before["memory"]) / 1e6, GROWTH)
    measured.at_most("folders of notes", report["notes"], report["history"])
    measured.at_most("jobs that are remembered", report["remembered"], report["history"])
    measured.at_most("temporary files", report["temporary"], 0)
    measured.holds(
        f"no session file or timer stays: {report['sessions']}, {report['timer']}", not report["sessions"] and not report["timer"]
    )


@case("20 jobs with random cancels", "After them Blender has no more open files, threads, processes, timers or memory than before.")
def few(measured: Measured) -> None:
    """Check 20 jobs."""
    check_queue(measured, 20)


@case("200 jobs with random cancels", "The same.", quick=False)
def many(measured: Measured) -> None:
    """Check 200 jobs."""
    check_queue(measured, 200)
