# SPDX-License-Identifier: GPL-3.0-or-later
"""Processes of jobs: cancelled, failed, vanished, of other Blenders that live or are gone; a quick script stands for the engine."""

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
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.irgspp_addon.jobs import session

pytestmark = pytest.mark.usefixtures("registry")


def test_second_cancel_ends_what_does_not_listen(tmp_path):
    script = tmp_path / "deaf.py"
    script.write_text("import time\ntime.sleep(600)")
    job = jobs.start("render", "deaf", None, [], program=str(script))
    until(lambda: (job.notes / "worker.json").exists())
    jobs.cancel(job)
    jobs.poll()
    assert job.state == "running"
    jobs.cancel(job)
    jobs.wait(job, PATIENCE)
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
    job = jobs.wait(jobs.start("render", "fails", None, [], program=str(script)), PATIENCE)
    assert job.state == "failed" and words in job.error and "\n" not in job.error


def test_worker_that_vanished_unseen_is_lost(counter):
    job = counter()
    until(lambda: job.step > 0)
    process = job_process._processes.pop(job.id)  # as after a restart: nobody holds the process
    process.kill()
    process.wait()
    until(lambda: job.finished)
    assert job.state == "lost" and "without saying how" in job.error


@POSIX
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_script_that_waits_is_interrupted(counter, kind):
    job, before = counter(), signal.getsignal(kind)

    def interrupt(job):
        if job.step > 2 and not job.stopping:
            os.kill(os.getpid(), kind)

    jobs.wait(job, PATIENCE, watch=interrupt)
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
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.irgspp_addon.jobs import session
place = lambda name="": Path(sys.argv[2]) / name
for module in (jobs, session, user_folder, engine):
    module.user_folder = place
engine_keeps = sys.argv[3] == "keep"
jobs.keep_running = lambda: engine_keeps
jobs.refresh()
first = jobs.start("render", "other's", None, [sys.argv[5]], program=sys.argv[4])
second = jobs.start("render", "other's second", None, ["3"], program=sys.argv[4])
while first.step < 3:
    jobs.poll()
    time.sleep(0.02)
print("ids", first.id, second.id, flush=True)
sys.stdin.readline()
"""


@pytest.fixture
def other_blender(registry):
    """Start another process with jobs in the same registry; it ends when its input is closed."""
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


def test_jobs_of_a_blender_that_is_gone_are_looked_after(other_blender):
    process, ids = other_blender("keep", 250)
    jobs.refresh()
    first, second = map(jobs.find, ids)
    assert (first.state, second.state) == ("running", "queued")
    jobs.poll()
    assert second.state == "queued"  # that is the other one's business while it lives
    process.kill()
    process.wait()
    jobs.refresh()
    assert first.owner == second.owner == session.session_file().name
    assert first.state == "running"
    until(lambda: first.finished and second.finished)
    assert (first.state, second.state) == ("done", "done")
    assert first.output().strip() == "counted 250"


def test_without_the_wish_a_job_ends_with_its_blender(other_blender):
    process, ids = other_blender("end")
    process.kill()
    process.wait()
    jobs.refresh()
    first = jobs.find(ids[0])
    until(lambda: first.finished)
    assert first.state == "cancelled"
    assert any("Blender has ended" in line for line in first.log_tail())


def test_two_blenders_see_each_others_jobs_and_can_stop_them(other_blender):
    process, ids = other_blender("keep")
    jobs.refresh()
    first = jobs.find(ids[0])
    jobs.cancel(first)
    deadline = time.monotonic() + PATIENCE
    while first.state == "running" and not (first.notes / "exit.json").exists():
        jobs.poll()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert json.loads((first.notes / "exit.json").read_text())["status"] == 130
    assert process.poll() is None
