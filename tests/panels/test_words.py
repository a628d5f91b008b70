# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts of times, phases and metrics; lines that fit the sidebar."""

import time
from pathlib import Path
from types import SimpleNamespace

import blf
import bpy
import pytest
from irgspp.irgspp_addon.jobs.job import Job
from irgspp.panels import run_state
from irgspp.panels.job_card import metrics_text, progress_text, total_text
from irgspp.panels.jobs import job_when
from irgspp.panels.phases import CAPTURE_NUMBERS, CAPTURE_STEPS, NUMBERS, SHARES, STEPS, phase_in_words, total_fraction
from irgspp.panels.sidebar import room, say, seconds_in_words, wrapped
from recording_layout import RecordingLayout

CORE = Path(__file__).resolve().parents[2] / "core"


def job(**values):
    return Job("1", "reconstruct", "spot", Path("run"), Path("notes"), **values)


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.2, "0 s"), (59.4, "59 s"), (59.6, "1:00 min"), (185, "3:05 min"), (3599.6, "1:00 h"), (7620, "2:07 h")]
)
def test_seconds(seconds, text):
    assert seconds_in_words(seconds) == text


def phases_of(*folders: str) -> set[str]:
    return {
        line.split('.phase("')[1].split('"')[0]
        for folder in folders
        for path in (CORE / folder).rglob("*.py")
        if path.name != "export.py"  # `inspect --export`, no part of a reconstruction
        for line in path.read_text().splitlines()
        if '.phase("' in line
    }


def test_every_phase_that_a_reconstruction_names_has_words():
    assert phases_of("stages", "stereo", "surface", "datasets") | {"scene", "contact sheet"} == set(NUMBERS)
    assert phase_in_words("reconstruct", "refine") == f"Step 5 of {len(STEPS)}: {STEPS[4][0]}"
    assert phase_in_words("install", "download torch") == "Download torch"
    assert phase_in_words("reconstruct", "") == "Starting"


def test_every_phase_that_a_capture_names_has_words():
    assert phases_of("capture") | {"read photographs"} == set(CAPTURE_NUMBERS)
    last = f"of {len(CAPTURE_STEPS)}: Cutting out the object"
    assert phase_in_words("capture", "cut out the object") == f"Step 7 {last}"
    assert phase_in_words("reconstruct", "cut out the object") == f"Cameras, step 7 {last}"  # of photographs without cameras
    assert phase_in_words("bake", "match photographs") == "Match photographs"


def test_progress_and_metrics():
    assert progress_text(job(step=23, of=50, eta=80.0)) == "46 %, 1:20 min left"
    assert progress_text(job(step=1, of=4)) == "25 %"
    assert progress_text(job()) == "Working"
    assert progress_text(job(step=50, of=50, eta=0.0)) == "Finishing this step"  # not "100 %, 0 s left" while work goes on
    assert metrics_text(job(metrics={"loss": 0.01234, "psnr": 31.26})) == "Loss 0.0123   PSNR 31.3 dB"
    assert metrics_text(job(metrics={"gaussians": 3.0})) == ""


def test_the_whole_time_is_estimated_from_what_was_seen():
    run = job(began=10.0, phase="first stage", step=0, of=100)
    assert set(SHARES) == set(NUMBERS)
    assert total_text(run, 1000.0) == ""
    run.step = 10
    assert total_text(run, 1010.0) == ""  # too early
    run.phase, run.step = "second stage", 50
    done, before = total_fraction("reconstruct", "second stage", 0.5), total_fraction("reconstruct", "first stage", 0.0)
    minutes = 600 * (1 - done) / (done - before) / 60
    assert total_text(run, 1600.0) == f"About {minutes:.0f} min left in all"
    run.phase = "contact sheet"
    assert total_text(run, 1600.0) == "About a minute left in all"
    assert total_fraction("bake", "bake", 0.5) is None and total_fraction("reconstruct", "match photographs", 0.5) is None
    assert total_fraction("demo", "contact sheet", 1.0) == 1.0


def test_when_a_job_was():
    assert job_when(job(state="running", step=1, of=3)) == "33 %"
    assert job_when(job(state="queued")) == ""
    now = time.time()
    assert job_when(job(state="done", ended=now)) == time.strftime("%H:%M", time.localtime(now))
    assert job_when(job(state="done", ended=now - 3 * 86400)) == time.strftime("%d %b", time.localtime(now - 3 * 86400))


@pytest.mark.parametrize("width", [120, 280, 600])
def test_text_is_wrapped_to_the_width_and_no_word_is_lost(width):
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0), ui_styles=bpy.context.preferences.ui_styles)
    context = SimpleNamespace(region=SimpleNamespace(width=width), preferences=preferences)
    text = "What was understood of the dataset, and its problems in words that are long enough for several lines."
    layout = RecordingLayout()
    say(layout, context, text, icon="INFO")
    lines = [entry[1] for entry in layout.drawn]
    assert " ".join(lines) == text
    wide, most = [blf.dimensions(0, line)[0] for line in lines], room(context, with_icon=True)
    assert max(wide) <= most
    firsts = [blf.dimensions(0, f" {line.split()[0]}")[0] for line in lines[1:]]
    assert all(before + first > most - 2 for before, first in zip(wide, firsts, strict=False)), "a word had room in the line before"
    assert [entry[2] for entry in layout.drawn] == ["INFO"] + ["BLANK1"] * (len(lines) - 1)


def test_a_long_path_is_broken_within_itself():
    path = "/home/somebody/photographs/of_a_chair_in_the_garden_that_was_taken_last_summer/transforms.json"
    lines = wrapped(f"{path}: no such file", 150.0, 11.0)
    assert "".join(lines).replace(" ", "") == f"{path}:nosuchfile" and len(lines) > 3
    assert all(blf.dimensions(0, line)[0] <= 150 for line in lines)


def test_run_state_reads_the_folder_at_most_twice_a_second(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(run_state.time, "monotonic", lambda: now[0])
    look = lambda: run_state.run_state(tmp_path).status  # noqa: E731
    assert look() == "" and run_state.run_state(None).status == ""
    (tmp_path / "run.json").write_text(
        '{"status": "done", "training": {"psnr": 30.0}, "skipped": [{"what": "scene.blend", "why": "no bpy"}]}'
    )
    now[0] += 0.4
    assert look() == ""
    now[0] += 0.2
    assert look() == "done"
    assert run_state.run_state(tmp_path).skipped == ("scene.blend: no bpy",)
    (tmp_path / "run.json").write_text("{")
    now[0] += 1
    assert look() == "broken"
