# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs with the real engine: finished, cancelled, crashed, on a full disk, without the engine; of some, the processes are copies."""

import json
import os
import signal
import stat
from pathlib import Path

import pytest
from blender_side import ENGINE, warm
from engine_jobs import PATIENCE, POSIX, leave_finished, reconstruction, until
from engine_jobs import registry as registry
from irgspp.core.errors import InputError
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.jobs import queue
from irgspp.irgspp_addon.jobs.job import load_job

pytestmark = pytest.mark.usefixtures("registry")


def run_state(run: Path) -> dict:
    return json.loads((run / "run.json").read_text())


def test_reconstruction_reports_progress_and_writes_a_run(tmp_path, tmp_path_factory):
    finished = []
    queue.ON_DONE["test"] = finished.append
    job = queue.start("reconstruct", "tiny", tmp_path / "run", reconstruction(tmp_path / "run"), on_done="test", data={"a": 1})
    seen = set()

    def ended():
        seen.add((job.state, job.phase))
        return job.finished

    until(ended)
    del queue.ON_DONE["test"]
    assert (job.state, job.error) == ("done", None), job.log_tail()
    assert {state for state, _ in seen} == {"running", "done"}
    assert {"first stage", "second stage"} & {phase for _, phase in seen}
    assert 0 < job.metrics["loss"] < 1 and 5 < job.metrics["psnr"] < 60
    assert job.preview == tmp_path / "run" / "previews" / "latest.png"
    assert job.preview.read_bytes().startswith(b"\x89PNG")
    assert job.output().strip() == str(tmp_path / "run")
    assert finished == [job] and load_job(job.notes).state == "done"
    assert run_state(tmp_path / "run")["status"] == "done"
    assert (tmp_path / "run" / "mesh.ply").exists()
    leave_finished(tmp_path / "run", tmp_path_factory)


def test_cancelled_reconstruction_is_resumed_and_finishes_early(tmp_path, monkeypatch):
    monkeypatch.setenv("IRGSPP_PYTHON", warm())
    words = reconstruction(tmp_path / "run", first__iterations=1_000_000)
    job = queue.start("reconstruct", "tiny", tmp_path / "run", words)
    until(lambda: job.phase == "first stage" and job.step > 0)
    assert not job.resumable and job.can_finish_early
    queue.cancel(job)
    assert job.stopping and not job.can_finish_early
    until(lambda: job.finished)
    assert (job.state, job.error) == ("cancelled", None)
    assert run_state(tmp_path / "run")["status"] == "cancelled"
    assert job.resumable
    queue.resume(job)
    assert (job.state, job.stopping) == ("running", False)
    until(lambda: job.phase == "first stage" and job.step > 0)
    queue.finish_early(job)
    until(lambda: job.finished)
    assert (job.state, job.error) == ("done", None), job.log_tail()
    state = run_state(tmp_path / "run")
    assert state["settings"]["first"]["iterations"] == 1_000_000 and state["status"] == "done"
    assert (tmp_path / "run" / "asset.glb").exists()
    with pytest.raises(InputError, match="finish early"):
        queue.finish_early(job)


@POSIX
def test_crash_is_reported_and_can_be_resumed(tmp_path, monkeypatch):
    monkeypatch.setenv("IRGSPP_PYTHON", warm())
    job = queue.start("reconstruct", "tiny", tmp_path / "run", reconstruction(tmp_path / "run", first__iterations=1_000_000))
    until(lambda: job.phase == "first stage" and job.step > 0)
    os.kill(json.loads((job.notes / "worker.json").read_text())["pid"], signal.SIGKILL)
    until(lambda: job.finished)
    assert job.state == "failed" and "SIGKILL" in job.error and "\n" not in job.error
    assert any("first stage" in line or "read images" in line for line in job.log_tail())
    assert job.resumable
    queue.resume(job)  # the lock of the run folder is free again
    until(lambda: job.phase == "first stage" and job.step > 0)
    queue.cancel(job)
    until(lambda: job.finished)
    assert job.state == "cancelled"


def test_missing_dataset_is_reported_in_one_line(tmp_path):
    job = queue.start("inspect", "gone", None, ["inspect", str(tmp_path / "gone")])
    queue.wait(job, PATIENCE)
    assert job.state == "failed" and "gone" in job.error and "no such" in job.error
    assert "Traceback" not in job.error


@POSIX
def test_full_disk_is_reported_in_one_line_and_loses_nothing(tmp_path, monkeypatch):
    """A limit on the size of files replaces the full disk: both make writing fail during the work."""
    wrapper = tmp_path / "python"
    wrapper.write_text(f'#!/bin/sh\nulimit -f 100\nexec "{ENGINE}" "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("IRGSPP_PYTHON", str(wrapper))
    job = queue.start("reconstruct", "tiny", tmp_path / "run", reconstruction(tmp_path / "run"))
    queue.wait(job, PATIENCE)
    assert job.state == "failed" and "larger than this system allows" in job.error and "\n" not in job.error
    assert run_state(tmp_path / "run")["status"] == "failed"
    monkeypatch.setenv("IRGSPP_PYTHON", warm())
    queue.resume(job)
    until(lambda: job.phase == "second stage" or job.finished)
    assert job.state == "running", job.log_tail()


@POSIX
def test_engine_that_is_deleted_while_a_job_runs(tmp_path, monkeypatch):
    wrapper = tmp_path / "python"
    wrapper.write_text(f'#!/bin/sh\nexec "{warm()}" "$@"\n')
    wrapper.chmod(wrapper.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("IRGSPP_PYTHON", str(wrapper))
    first = queue.start("reconstruct", "tiny", tmp_path / "run", reconstruction(tmp_path / "run", first__iterations=1_000_000))
    second = queue.start("render", "waits", None, ["render", str(tmp_path / "run")])
    until(lambda: first.phase == "first stage" and first.step > 0)
    wrapper.unlink()
    assert engine.status().state == "missing" and str(wrapper) in engine.status().text
    with pytest.raises(InputError, match="can't be started"):
        queue.start("render", "third", None, ["render", str(tmp_path / "run")])
    queue.cancel(first)
    until(lambda: first.finished and second.finished)
    assert first.state == "cancelled"  # the running job is not disturbed
    assert second.state == "failed" and "can't be started" in second.error
    monkeypatch.setenv("IRGSPP_PYTHON", ENGINE)
    assert first.resumable
