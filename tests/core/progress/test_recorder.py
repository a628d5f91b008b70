# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress recorder: event log, previews, and files that cancel or finish a job."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from irgspp.core.progress import recorder
from irgspp.core.progress.event_log import EventLog
from irgspp.core.progress.protocol import Silent
from irgspp.core.progress.recorder import JobLog, JobRecorder, ProgressRecorder
from irgspp.core.progress.terminal import Terminal
from PIL import Image


def events(folder):
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


class Clock:
    """Clock that only tests advance."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr(recorder.time, "monotonic", lambda: self.now)


def test_files_cancel_and_finish_early(tmp_path):
    progress = ProgressRecorder(EventLog(tmp_path), Silent())
    assert not progress.cancelled and not progress.finish_early
    (tmp_path / "finish").touch()
    assert progress.finish_early and not progress.cancelled
    progress.phase("next", 3)
    assert not progress.finish_early  # the request was for the phase before
    (tmp_path / "cancel").touch()
    progress.phase("again", 3)
    assert progress.cancelled


def test_events_are_complete_but_rare(tmp_path, monkeypatch):
    clock, progress = Clock(monkeypatch), ProgressRecorder(EventLog(tmp_path), Silent())
    progress.phase("fit", 1000)
    for step in range(1, 1001):
        clock.now += 0.01
        progress.step(step, loss=1 / step, psnr=float("inf") if step == 1000 else 20.0)
    progress.message("done")
    written = events(tmp_path)
    assert written[0]["phase"] == "fit" and written[0]["of"] == 1000
    assert 30 < len(written) < 50
    assert (written[-2]["step"], written[-2]["psnr"]) == (1000, None)
    assert written[-1]["message"] == "done"
    assert progress.metrics["loss"] == pytest.approx(1e-3)


def test_previews_take_little_time(tmp_path, monkeypatch):
    """They are drawn rarely, and more rarely the longer one takes."""
    clock, drawn = Clock(monkeypatch), []
    progress = ProgressRecorder(EventLog(tmp_path), Silent())
    progress.phase("fit", 10)

    def draw(seconds):
        clock.now += seconds
        drawn.append(clock.now)
        return np.full((4, 6, 3), len(drawn), np.uint8)

    for _ in range(100):
        clock.now += 1.0
        progress.image(lambda: draw(0.05))
    assert len(drawn) == 10
    shown = np.asarray(Image.open(tmp_path / recorder.PREVIEW))
    assert shown.shape == (4, 6, 3) and (shown == 10).all()
    assert [e["preview"] for e in events(tmp_path) if "preview" in e] == ["previews/latest.png"] * 10
    clock.now += 100.0
    progress.image(lambda: draw(2.0))  # a slow one
    for _ in range(199):
        clock.now += 1.0
        progress.image(lambda: draw(2.0))
    assert len(drawn) == 11
    clock.now += 2.0
    progress.image(lambda: draw(2.0))
    assert len(drawn) == 12
    assert sorted(p.name for p in (tmp_path / "previews").iterdir()) == ["latest.png"]


def test_shapes_are_rare_but_the_last_one_is_not_missed(tmp_path, monkeypatch):
    clock, progress = Clock(monkeypatch), ProgressRecorder(EventLog(tmp_path), Silent())
    progress.phase("fit", 10)
    taken = []

    def sample():
        taken.append(clock.now)
        return {"position": np.full((2, 3), len(taken), np.float32), "colour": np.zeros((2, 3), np.float32)}

    for _ in range(35):
        clock.now += 1.0
        progress.shape(sample)
    assert len(taken) == 4
    progress.shape(sample, at_once=True)
    with np.load(tmp_path / recorder.SHAPE) as stored:
        assert (stored["position"] == 5).all() and sorted(stored) == ["colour", "position"]


def test_progress_of_a_terminal_that_a_program_follows(tmp_path, capsys):
    progress = JobRecorder(JobLog(tmp_path), Terminal())
    progress.phase("read", 2)
    progress.step(2)
    progress.message("odd image")
    progress.end_line()
    assert [e.get("message") for e in events(tmp_path)][-1] == "odd image"
    assert "odd image" in capsys.readouterr().err
    assert not (tmp_path / "log.txt").exists()  # the terminal's output is the log


def test_commands_obey_the_folder_of_the_program_that_started_them(tmp_path):
    words = [sys.executable, "-m", "irgspp", "inspect", str(tmp_path / "none")]
    folder = tmp_path / "job"
    folder.mkdir()
    done = subprocess.run(words, env=os.environ | {"IRGSPP_JOB": str(folder)}, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    from irgspp.core.pipeline import DEMO_DATA

    (folder / "cancel").touch()
    words[-1] = str(DEMO_DATA)
    done = subprocess.run(words, env=os.environ | {"IRGSPP_JOB": str(folder)}, capture_output=True, text=True, check=False)
    assert done.returncode == 130, done.stderr
    assert "cancelled" in done.stderr
