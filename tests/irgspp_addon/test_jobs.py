# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs with the real worker: the engine on the embedded dataset, and a quick script in its place where only the keeping of jobs matters."""

import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import bpy
import pytest
from blender_side import ENGINE, ROOT
from engine_jobs import COUNTER, reconstruction, until
from engine_jobs import registry as registry
from irgspp.core.errors import InputError, IrgsppError
from irgspp.core.lock import FileLock
from irgspp.irgspp_addon import engine, jobs, session
from irgspp.irgspp_addon.job import load_job

pytestmark = pytest.mark.usefixtures("registry")
PATIENCE = 300.0  # seconds, on a machine that has other things to do
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and links of POSIX")


@pytest.fixture
def counter(tmp_path):
    """Start a job that counts; its script and steps."""
    script = tmp_path / "counter.py"
    script.write_text(COUNTER)

    def start(steps=1000, kind="render", **options):
        return jobs.start(kind, f"count to {steps}", options.pop("folder", None), [str(steps)], program=str(script), **options)

    return start


def run_state(run: Path) -> dict:
    return json.loads((run / "run.json").read_text())


# --- the engine


def test_reconstruction_tells_its_progress_and_ends_with_a_run(tmp_path):
    told = []
    jobs.ON_DONE["test"] = told.append
    job = jobs.start("reconstruct", "tiny", tmp_path / "run", reconstruction(tmp_path / "run"), on_done="test", data={"a": 1})
    seen = set()

    def ended():
        seen.add((job.state, job.phase))
        return job.finished

    until(ended)
    del jobs.ON_DONE["test"]
    assert (job.state, job.error) == ("done", None), job.log_tail()
    assert {state for state, _ in seen} == {"running", "done"}
    assert {"reflective", "transport"} & {phase for _, phase in seen}
    assert 0 < job.figures["loss"] < 1 and 5 < job.figures["psnr"] < 60
    assert job.preview == tmp_path / "run" / "previews" / "latest.png"
    assert job.preview.read_bytes().startswith(b"\x89PNG")
    assert job.output().strip() == str(tmp_path / "run")
    assert told == [job] and load_job(job.notes).state == "done"
    assert run_state(tmp_path / "run")["status"] == "done"
    assert (tmp_path / "run" / "mesh.ply").exists()


def test_cancelled_reconstruction_goes_on_and_finishes_early(tmp_path):
    words = reconstruction(tmp_path / "run", reflective__iterations=1_000_000)
    job = jobs.start("reconstruct", "tiny", tmp_path / "run", words)
    until(lambda: job.phase == "reflective" and job.step > 0)
    assert not job.resumable and job.can_finish_early
    jobs.cancel(job)
    assert job.stopping and not job.can_finish_early
    until(lambda: job.finished)
    assert (job.state, job.error) == ("cancelled", None)
    assert run_state(tmp_path / "run")["status"] == "cancelled"
    assert job.resumable
    jobs.resume(job)
    assert (job.state, job.stopping) == ("running", False)
    until(lambda: job.phase == "reflective" and job.step > 0)
    jobs.finish_early(job)
    until(lambda: job.finished)
    assert (job.state, job.error) == ("done", None), job.log_tail()
    state = run_state(tmp_path / "run")
    assert state["settings"]["reflective"]["iterations"] == 1_000_000 and state["status"] == "done"
    assert (tmp_path / "run" / "asset.glb").exists()
    with pytest.raises(InputError, match="finish early"):
        jobs.finish_early(job)


@POSIX
def test_crash_is_told_with_the_last_words_and_can_be_resumed(tmp_path):
    job = jobs.start("reconstruct", "tiny", tmp_path / "run", reconstruction(tmp_path / "run", reflective__iterations=1_000_000))
    until(lambda: job.phase == "reflective" and job.step > 0)
    os.kill(json.loads((job.notes / "worker.json").read_text())["pid"], signal.SIGKILL)
    until(lambda: job.finished)
    assert job.state == "failed" and "SIGKILL" in job.error and "\n" not in job.error
    assert any("reflective" in line or "read pictures" in line for line in job.log_tail())
    assert job.resumable
    jobs.resume(job)  # the lock of the run folder is free again
    until(lambda: job.phase == "reflective" and job.step > 0)
    jobs.cancel(job)
    until(lambda: job.finished)
    assert job.state == "cancelled"


def test_dataset_that_was_moved_is_one_line(tmp_path):
    job = jobs.start("inspect", "gone", None, ["inspect", str(tmp_path / "gone")])
    jobs.wait(job, PATIENCE)
    assert job.state == "failed" and "gone" in job.error and "no such" in job.error
    assert "Traceback" not in job.error


@POSIX
def test_disk_that_fills_up_is_one_line_and_loses_nothing(tmp_path, monkeypatch):
    """A limit on the size of files stands for the full disk: both make writing fail in the middle of the work."""
    wrapper = tmp_path / "python"
    wrapper.write_text(f'#!/bin/sh\nulimit -f 100\nexec "{ENGINE}" "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("IRGSPP_PYTHON", str(wrapper))
    job = jobs.start("reconstruct", "tiny", tmp_path / "run", reconstruction(tmp_path / "run"))
    jobs.wait(job, PATIENCE)
    assert job.state == "failed" and "File too large" in job.error and "\n" not in job.error
    assert run_state(tmp_path / "run")["status"] == "failed"
    monkeypatch.setenv("IRGSPP_PYTHON", ENGINE)
    jobs.resume(job)
    until(lambda: job.phase == "transport" or job.finished)
    assert job.state == "running", job.log_tail()


@POSIX
def test_engine_that_is_deleted_while_a_job_runs(tmp_path, monkeypatch):
    wrapper = tmp_path / "python"
    wrapper.write_text(f'#!/bin/sh\nexec "{ENGINE}" "$@"\n')
    wrapper.chmod(wrapper.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("IRGSPP_PYTHON", str(wrapper))
    first = jobs.start("reconstruct", "tiny", tmp_path / "run", reconstruction(tmp_path / "run", reflective__iterations=1_000_000))
    second = jobs.start("render", "waits", None, ["render", str(tmp_path / "run")])
    until(lambda: first.phase == "reflective" and first.step > 0)
    wrapper.unlink()
    assert engine.status().state == "missing" and str(wrapper) in engine.status().text
    with pytest.raises(InputError, match="can't be started"):
        jobs.start("render", "third", None, ["render", str(tmp_path / "run")])
    jobs.cancel(first)
    until(lambda: first.finished and second.finished)
    assert first.state == "cancelled"  # what runs is not disturbed
    assert second.state == "failed" and "can't be started" in second.error
    monkeypatch.setenv("IRGSPP_PYTHON", ENGINE)
    assert first.resumable


# --- the keeping of jobs


def test_jobs_wait_for_each_other_but_short_ones_do_not(counter):
    first, second, third = counter(), counter(), counter()
    short = counter(3, kind="inspect")
    assert [job.state for job in (first, second, third, short)] == ["running", "queued", "queued", "running"]
    assert jobs.all_jobs() == [short, third, second, first] and set(jobs.running()) == {first, short}
    jobs.cancel(third)
    assert third.state == "cancelled"
    until(lambda: short.finished and first.step > 2)
    assert short.state == "done" and short.output().strip() == "counted 3"
    jobs.cancel(first)
    until(lambda: first.finished)
    assert second.state == "running"
    assert 0 < first.fraction < 1 and first.of == 1000
    jobs.cancel(second)
    jobs.wait(second, PATIENCE)


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


def test_failing_import_of_the_result_is_told_and_spoils_nothing(counter):
    def broken(job):
        raise IrgsppError("another file is open")

    jobs.ON_DONE["broken"] = broken
    job = jobs.wait(counter(2, on_done="broken"), PATIENCE)
    del jobs.ON_DONE["broken"]
    assert job.state == "done" and "another file is open" in job.error


def test_one_job_per_folder(tmp_path, counter):
    counter(folder=tmp_path / "run", kind="reconstruct")
    with pytest.raises(InputError, match=r"count to 1000 is running for this folder"):
        counter(folder=tmp_path / "run", kind="reconstruct")
    assert counter(folder=tmp_path / "run", kind="render").state == "queued"  # reads it later


def test_folder_that_another_program_works_in(tmp_path, counter):
    (tmp_path / "run").mkdir()
    lock = FileLock(tmp_path / "run" / ".lock")
    with pytest.raises(InputError, match="in use by another Blender"):
        counter(folder=tmp_path / "run", kind="reconstruct")
    lock.release()
    assert jobs.all_jobs() == []
    assert counter(folder=tmp_path / "run", kind="reconstruct").state == "running"


def test_forgetting_takes_the_notes_and_nothing_else(tmp_path, counter):
    (tmp_path / "run").mkdir()
    job = counter(2, folder=tmp_path / "run", kind="reconstruct")
    with pytest.raises(InputError, match="cancel it first"):
        jobs.forget(job)
    jobs.wait(job, PATIENCE)
    jobs.forget(job)
    assert jobs.all_jobs() == [] and not job.notes.exists() and (tmp_path / "run").exists()
    assert jobs.find(job.id) is None


def test_history_is_short(counter, monkeypatch):
    monkeypatch.setattr(jobs, "HISTORY", 2)
    made = [jobs.wait(counter(1), PATIENCE) for _ in range(4)]
    counter(1)
    assert [job.id for job in jobs.all_jobs()[1:]] == [made[3].id, made[2].id]
    assert not made[0].notes.exists()


def test_listeners_hear_of_jobs(counter):
    heard = []
    jobs.CHANGED.append(heard.append)
    job = counter(1)
    jobs.CHANGED.remove(heard.append)
    assert heard == [[job.id]]


def test_saving_a_file_leaves_jobs_alone(tmp_path, counter):
    job = counter(30)
    until(lambda: job.step > 2)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    jobs.refresh()
    assert jobs.find(job.id) is job and job.state == "running"
    assert jobs.wait(job, PATIENCE).state == "done"


def test_notes_that_are_broken_are_no_jobs(counter):
    job = jobs.wait(counter(1), PATIENCE)
    for name, text in (("a", "{"), ("b", "[]"), ("c", '{"id": 1}')):
        (jobs.jobs_folder() / name).mkdir()
        (jobs.jobs_folder() / name / "job.json").write_text(text)
    with (job.notes / "events.jsonl").open("a") as events:
        events.write('{"phase": "tru\n[1]\nnull\n{"phase": "late", "step": 1, "of": 2}\n{"phase": "unfinished li')
    jobs.clear()
    jobs.refresh()
    (found,) = jobs.all_jobs()
    assert (found.id, found.state, found.phase, found.step) == (job.id, "done", "late", 1)


# --- other Blenders

OTHER = """
import sys, time
import runpy
runpy.run_path(sys.argv[1] + "/irgspp_addon/launch.py")["mount"](__import__("pathlib").Path(sys.argv[1]))
import bpy
from pathlib import Path
from irgspp.irgspp_addon import jobs, session, user_folder, engine
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
def other_blender(tmp_path, registry):
    """Start another process with jobs in the same registry; it ends when its input is closed."""
    script = tmp_path / "counter.py"
    script.write_text(COUNTER)
    registry.joinpath("jobs").mkdir(parents=True)
    started = []

    def start(keep, steps=10_000):
        words = [sys.executable, "-c", OTHER, str(ROOT), str(registry), keep, str(script), str(steps)]
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


def test_worker_that_vanished_unseen_is_lost(counter):
    job = counter()
    until(lambda: job.step > 0)
    from irgspp.irgspp_addon import job_process

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
