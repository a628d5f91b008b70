# SPDX-License-Identifier: GPL-3.0-or-later
"""Time and memory of photographs without cameras are known before a capture, and grow with the work."""

import json
from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.capture import expected_work
from irgspp.core.capture.expected_work import USUAL_SIZE, capture_seconds, expected_dataset, summarize_photographs
from irgspp.core.cli.main import main
from irgspp.core.machine import job_time
from irgspp.core.settings.schema import PRESETS, Settings
from PIL import Image

SETTINGS = Settings()


@pytest.fixture(autouse=True)
def no_history(tmp_path, monkeypatch):
    monkeypatch.setattr(job_time, "private_folder", lambda name: tmp_path)
    monkeypatch.setenv("IRGSPP_THREADS", "2")


@pytest.fixture
def photographs(tmp_path):
    folder = tmp_path / "photographs"
    folder.mkdir()
    for number in range(12):
        Image.fromarray(np.zeros((48, 64, 3), np.uint8)).save(folder / f"{number}.png")
    return folder


@pytest.mark.parametrize(("count", "size", "seconds"), [(48, (640, 480), 76), (24, (4000, 3000), 238)])
def test_measured_captures_are_met(count, size, seconds):
    assert capture_seconds(SETTINGS, count, size) == pytest.approx(seconds, rel=0.1)


def test_more_and_larger_photographs_take_longer():
    few, many, large = (capture_seconds(SETTINGS, *job) for job in ((20, (640, 480)), (40, (640, 480)), (20, (1280, 960))))
    assert few < large and 1.5 * few < many
    one, more = (capture_seconds(SETTINGS, count, (640, 480)) for count in (200, 400))
    assert more < 2.1 * one  # only similar photographs are matched
    beyond = [capture_seconds(SETTINGS, 20, size) for size in ((2000, 1500), (4000, 3000))]
    assert beyond[1] < 2 * beyond[0]  # features are searched at 2000 pixels at most


def test_the_whole_includes_the_capture(photographs):
    found = summarize_photographs(photographs, SETTINGS)
    assert (found["photographs"], found["videos"]) == (12, 0) and "jobs" in found and set(found["jobs"]) <= set(PRESETS)
    assert found["jobs"]["draft"]["seconds"] > found["capture"]["seconds"] > 0
    assert found["jobs"]["draft"]["memory"] >= found["capture"]["memory"] == expected_work.MEMORY
    assert found["jobs"]["draft"]["seconds"] < found["jobs"]["balanced"]["seconds"]


def test_videos_and_kinds_without_a_known_header_count_as_usual(tmp_path):
    (tmp_path / "turn.mp4").write_bytes(b"video")
    found = summarize_photographs(tmp_path, SETTINGS)
    assert (found["photographs"], found["videos"]) == (0, 1)
    assert found["capture"]["seconds"] == round(job_time.corrected_seconds(capture_seconds(SETTINGS, SETTINGS.capture.frames, USUAL_SIZE)))


def test_the_expected_dataset_is_like_a_captured_one(tmp_path):
    data = expected_dataset(tmp_path, SETTINGS, 17, (4000, 3000))
    assert (len(data.train), len(data.test), data.has_alpha) == (14, 3, True)
    assert (data.train[0].camera.width, data.train[0].camera.height) == (640, 480) and data.full_size_pixels == pytest.approx(12e6)
    whole = replace(SETTINGS, capture=replace(SETTINGS.capture, masks=False))
    assert not expected_dataset(tmp_path, whole, 17, (4000, 3000)).has_alpha


def test_the_command_tells_it(photographs, capsys):
    assert main(["inspect", str(photographs)]) == 0
    table = capsys.readouterr().out
    assert "none; reconstruct finds them first" in table and "12 png" in table and "the capture included" in table
    assert main(["inspect", str(photographs), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["format"] == "photographs"
