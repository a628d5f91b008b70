# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job notes down for those who watch from outside, and what it hears from them."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from irgspp.core.progress import recorder as journal
from irgspp.core.progress.event_log import EventLog
from irgspp.core.progress.protocol import Silent
from irgspp.core.progress.recorder import JobLog, JobRecorder, ProgressRecorder
from irgspp.core.progress.terminal import Terminal
from PIL import Image


def events(folder):
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


class Clock:
    """Time that passes only when told."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr(journal.time, "monotonic", lambda: self.now)


def test_files_ask_for_what_they_are_named_after(tmp_path):
    told = ProgressRecorder(EventLog(tmp_path), Silent())
    assert not told.cancelled and not told.finish_early
    (tmp_path / "finish").touch()
    assert told.finish_early and not told.cancelled
    told.phase("next", 3)
    assert not told.finish_early  # the wish was for the phase before
    (tmp_path / "cancel").touch()
    told.phase("again", 3)
    assert told.cancelled


def test_events_are_complete_but_rare(tmp_path, monkeypatch):
    clock, told = Clock(monkeypatch), ProgressRecorder(EventLog(tmp_path), Silent())
    told.phase("fit", 1000)
    for step in range(1, 1001):
        clock.now += 0.01
        told.step(step, loss=1 / step, psnr=float("inf") if step == 1000 else 20.0)
    told.message("done")
    noted = events(tmp_path)
    assert noted[0]["phase"] == "fit" and noted[0]["of"] == 1000
    assert 30 < len(noted) < 50
    assert (noted[-2]["step"], noted[-2]["psnr"]) == (1000, None)
    assert noted[-1]["message"] == "done"
    assert told.metrics["loss"] == pytest.approx(1e-3)


def test_images_cost_next_to_nothing(tmp_path, monkeypatch):
    """Seldom, and the more seldom the longer one takes."""
    clock, drawn = Clock(monkeypatch), []
    told = ProgressRecorder(EventLog(tmp_path), Silent())
    told.phase("fit", 10)

    def draw(seconds):
        clock.now += seconds
        drawn.append(clock.now)
        return np.full((4, 6, 3), len(drawn), np.uint8)

    for _ in range(100):
        clock.now += 1.0
        told.image(lambda: draw(0.05))
    assert len(drawn) == 10
    shown = np.asarray(Image.open(tmp_path / journal.PREVIEW))
    assert shown.shape == (4, 6, 3) and (shown == 10).all()
    assert [e["preview"] for e in events(tmp_path) if "preview" in e] == ["previews/latest.png"] * 10
    clock.now += 100.0
    told.image(lambda: draw(2.0))  # a slow one
    for _ in range(199):
        clock.now += 1.0
        told.image(lambda: draw(2.0))
    assert len(drawn) == 11
    clock.now += 2.0
    told.image(lambda: draw(2.0))
    assert len(drawn) == 12
    assert sorted(p.name for p in (tmp_path / "previews").iterdir()) == ["latest.png"]


def test_progress_of_a_terminal_that_a_program_watches(tmp_path, capsys):
    told = JobRecorder(JobLog(tmp_path), Terminal())
    told.phase("read", 2)
    told.step(2)
    told.message("odd image")
    told.end_line()
    assert [e.get("message") for e in events(tmp_path)][-1] == "odd image"
    assert "odd image" in capsys.readouterr().err
    assert not (tmp_path / "log.txt").exists()  # the terminal's output is the log


def test_commands_note_their_progress_where_they_are_told(tmp_path):
    words = [sys.executable, "-m", "irgspp", "inspect", str(tmp_path / "none")]
    told = tmp_path / "told"
    told.mkdir()
    done = subprocess.run(words, env=os.environ | {"IRGSPP_JOB": str(told)}, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    from irgspp.core.pipeline import DEMO_DATA

    (told / "cancel").touch()
    words[-1] = str(DEMO_DATA)
    done = subprocess.run(words, env=os.environ | {"IRGSPP_JOB": str(told)}, capture_output=True, text=True, check=False)
    assert done.returncode == 130, done.stderr
    assert "cancelled" in done.stderr
