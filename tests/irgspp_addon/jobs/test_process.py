# SPDX-License-Identifier: GPL-3.0-or-later
"""Processes of jobs: cancelled, failed, lost, of other Blenders that run or have ended; a quick script replaces the engine."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from blender_side import ROOT
from engine_jobs import COUNTER, PATIENCE, POSIX, until
from engine_jobs import counter as counter
from engine_jobs import registry as registry
from irgspp.irgspp_addon.jobs import process as job_process
from irgspp.irgspp_addon.jobs import queue, session

pytestmark = pytest.mark.usefixtures("registry")


def test_second_cancel_kills_a_job_that_does_not_stop(tmp_path):
    script = tmp_path / "deaf.py"
    script.write_text("import time\ntime.sleep(600)")
    job = queue.start("render", "deaf", None, [], program=str(script))
    until(lambda: (job.notes / "worker.json").exists())
    queue.cancel(job)
    queue.poll()
    assert job.state == "running"
    queue.cancel(job)
    queue.wait(job, PATIENCE)
    assert (job.state, job.error) == ("cancelled", None)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("raise SystemExit('irgspp: no light')", "no light"),
        ("raise ValueError('odd')", "ValueError: odd"),
        ("import os; os._exit(3)", "status 3: no message"),
        ("import sys; print('irgspp: a: b', file=sys.stderr); sys.exit(2)", "a: b"),
    ],
)
def test_failure_in_one_line(tmp_path, code, words):
    script = tmp_path / "fails.py"
    script.write_text(code)
    job = queue.wait(queue.start("render", "fails", None, [], program=str(script)), PATIENCE)
    assert job.state == "failed" and words in job.error and "\n" not in job.error


def test_worker_that_ended_unobserved_is_lost(counter):
    job = counter()
    until(lambda: job.step > 0)
    process = job_process._processes.pop(job.id)  # as after a restart of Blender: the process is no child of it
    process.kill()
    process.wait()
    until(lambda: job.finished)
    assert job.state == "lost" and "without an exit status" in job.error


@POSIX
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_script_that_waits_is_interrupted(counter, kind):
    job, before = counter(), signal.getsignal(kind)

    def interrupt(job):
        if job.step > 2 and not job.stopping:
            os.kill(os.getpid(), kind)

    queue.wait(job, PATIENCE, watch=interrupt)
    assert job.state == "cancelled" and signal.getsignal(kind) is before


# --- other Blenders

OTHER = """
import sys, time
import runpy
runpy.run_path(sys.argv[1] + "/irgspp_addon/launch.py")["mount"](__import__("pathlib").Path(sys.argv[1]))
import bpy
from pathlib import Path
from irgspp.irgspp_addon import user_folder
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.jobs import queue
from irgspp.irgspp_addon.jobs import session
place = lambda name="": Path(sys.argv[2]) / name
for module in (queue, session, user_folder, engine):
    module.user_folder = place
engine_keeps = sys.argv[3] == "keep"
queue.keep_running = lambda: engine_keeps
queue.refresh()
first = queue.start("render", "other's", None, [sys.argv[5]], program=sys.argv[4])
second = queue.start("render", "other's second", None, ["3"], program=sys.argv[4])
while first.step < 3:
    queue.poll()
    time.sleep(0.02)
print("ids", first.id, second.id, flush=True)
sys.stdin.readline()
"""


@pytest.fixture
def other_blender(registry):
    """Return a function that starts another process with jobs in the same registry, which ends when its stdin is closed."""
    registry.joinpath("jobs").mkdir(parents=True)
    started = []

    def start(keep, steps=10_000):
        words = [sys.executable, "-c", OTHER, str(ROOT), str(registry), keep, str(COUNTER), str(steps)]
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        started.append(process)
        ids = next(line.split()[1:] for line in iter(process.stdout.readline, "") if line.startswith("ids "))
        return process, ids

    yield start
    for process in started:
        process.kill()
        process.wait()


def test_jobs_of_an_ended_blender_are_taken_over(other_blender):
    process, ids = other_blender("keep", 250)
    queue.refresh()
    first, second = map(queue.find, ids)
    assert (first.state, second.state) == ("running", "queued")
    queue.poll()
    assert second.state == "queued"  # the other Blender manages it while it runs
    process.kill()
    process.wait()
    queue.refresh()
    assert first.owner == second.owner == session.session_file().name
    assert first.state == "running"
    until(lambda: first.finished and second.finished)
    assert (first.state, second.state) == ("done", "done")
    assert first.output().strip() == "counted 250"


def test_a_job_ends_with_its_blender_by_default(other_blender):
    process, ids = other_blender("end")
    process.kill()
    process.wait()
    queue.refresh()
    first = queue.find(ids[0])
    until(lambda: first.finished)
    assert (first.state, first.error) == ("cancelled", "Blender was closed")  # not by the user
    assert any("Blender has ended" in line for line in first.log_tail())


def test_two_blenders_see_and_can_cancel_each_others_jobs(other_blender):
    process, ids = other_blender("keep")
    queue.refresh()
    first = queue.find(ids[0])
    queue.cancel(first)
    deadline = time.monotonic() + PATIENCE
    while first.state == "running" and not (first.notes / "exit.json").exists():
        queue.poll()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert json.loads((first.notes / "exit.json").read_text())["status"] == 130
    assert process.poll() is None
