# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs are looked at as soon as they are chosen: what is lacking, thumbnails, and the engine's inspection."""

import os
import shutil
import time
from types import SimpleNamespace

import bpy
import irgspp
import pytest
from blender_side import ROOT
from irgspp.core.errors import IrgsppError
from irgspp.irgspp_addon import preferences_page, properties
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.importer.photographs import problem_of, sample_photographs
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.irgspp_addon.jobs.job import Job
from irgspp.operators import import_dataset
from irgspp.panels import cameras, capture_state, images, photographs, reconstruct
from recording_layout import draw

DEMO = ROOT / "core" / "demo_data"


@pytest.fixture
def settings(monkeypatch):
    """The panel's settings, with the extension registered and an engine that is said to work."""
    bpy.ops.wm.read_homefile(use_empty=True)
    monkeypatch.setattr(engine, "status", lambda: engine.Status("ok", "Engine 1"))
    irgspp.register()
    jobs.clear()
    capture_state.forget()
    yield bpy.context.scene.irgspp
    jobs.clear()
    irgspp.unregister()


def live(panel, operator: str) -> list[bool]:
    return [button.live for button in draw(panel).buttons(operator)]


@pytest.mark.parametrize(("name", "text"), [("empty", "no photographs in this folder"), ("gone", "not there")])
def test_a_folder_without_photographs_says_so_and_can_not_be_reconstructed(settings, tmp_path, name, text):
    (tmp_path / "empty").mkdir()
    settings.dataset = str(tmp_path / name)
    words = draw(photographs.IRGSPP_PT_photographs).words
    assert text in words and ".json" not in words  # no list of file names
    assert live(reconstruct.IRGSPP_PT_reconstruct, "irgspp.reconstruct") == [False]
    assert live(photographs.IRGSPP_PT_photographs, "irgspp.inspect_dataset") == [False]
    step = draw(cameras.IRGSPP_PT_cameras)
    assert step.words == "First choose photographs." and not step.buttons("irgspp.import_dataset")


def test_photographs_without_cameras_can_be_reconstructed_and_few_are_said_to_be_few(settings, tmp_path):
    for i in range(8):
        shutil.copy(DEMO / "train" / "r_000.png", tmp_path / f"{i}.png")
    settings.dataset = str(tmp_path)
    words = draw(photographs.IRGSPP_PT_photographs).words
    assert "without cameras: 8 files" in words and "That is few" in words
    assert live(reconstruct.IRGSPP_PT_reconstruct, "irgspp.reconstruct") == [True]
    for i in range(8, 30):
        shutil.copy(DEMO / "train" / "r_000.png", tmp_path / f"{i}.png")
    capture_state.forget()
    assert "few" not in draw(photographs.IRGSPP_PT_photographs).words


def test_thumbnails_of_the_photographs(settings, monkeypatch):
    shown = sample_photographs(DEMO)
    assert len(shown) == len(set(shown)) == 4 and all(path.suffix == ".png" for path in shown)
    settings.dataset = str(DEMO)
    pictures = [entry for entry in draw(photographs.IRGSPP_PT_photographs).drawn if entry[0] == "picture"]
    assert len(pictures) == 4 and set(images._written) >= set(map(str, shown))
    assert sample_photographs(DEMO / "transforms_train.json") == () and problem_of(DEMO / "transforms_train.json") == ""


def test_a_chosen_dataset_is_inspected_at_once(settings, tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(jobs, "start", lambda *words: started.append(words))
    assert [import_dataset._chosen] == properties.CHOSEN  # which does nothing without a window
    monkeypatch.setattr(properties, "CHOSEN", [import_dataset.inspect_chosen])
    settings.dataset = str(DEMO)
    assert [(words[0], words[3], words[4]) for words in started] == [("inspect", ["inspect", str(DEMO), "--json"], "show_inspection")]
    (tmp_path / "1.png").write_bytes(b"x")
    settings.dataset = str(tmp_path)  # without cameras the engine tells how long finding them takes
    assert started.pop()[3] == ["inspect", str(tmp_path), "--json"]
    settings.dataset = str(tmp_path / "gone")
    settings.dataset = ""
    properties.set_quietly(settings, "dataset", str(DEMO))
    assert len(started) == 1


def test_the_inspection_of_what_was_chosen_before_is_cancelled(settings, tmp_path, monkeypatch):
    before = Job("j1", "inspect", "Inspect", tmp_path, tmp_path, state="running", on_done="show_inspection")
    jobs._jobs[before.id] = before
    monkeypatch.setattr(jobs, "start", lambda *words: words)
    settings.dataset = str(DEMO)
    assert import_dataset.inspect_chosen(bpy.context.scene) and before.stopping


def test_an_inspection_that_can_not_start_is_no_error(settings, monkeypatch):
    def refuse(*_):
        raise IrgsppError("the disk is full")

    monkeypatch.setattr(jobs, "start", refuse)
    settings.dataset = str(DEMO)
    assert import_dataset.inspect_chosen(bpy.context.scene) is None


def test_the_error_of_an_inspection_goes_when_the_folder_changes(settings, tmp_path):
    settings.dataset = str(tmp_path)
    data = {"dataset": str(tmp_path.resolve())}
    job = Job("j1", "inspect", "Inspect", tmp_path, tmp_path, state="failed", error="frame 3 is broken", ended=time.time() + 1, data=data)
    jobs._jobs[job.id] = job
    assert "frame 3 is broken" in draw(photographs.IRGSPP_PT_photographs).words
    os.utime(tmp_path, (time.time() + 5, time.time() + 5))
    assert "frame 3 is broken" not in draw(photographs.IRGSPP_PT_photographs).words


def test_an_engine_is_checked_when_it_is_chosen(settings, monkeypatch):
    checked = []
    monkeypatch.setattr(preferences_page, "check_in_background", lambda: checked.append(1))
    monkeypatch.setattr(preferences_page, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))
    for state, times in (("ok", 0), ("missing", 0), ("unknown", 1)):
        monkeypatch.setattr(preferences_page, "status", lambda state=state: engine.Status(state, ""))
        preferences_page._check_chosen(None, bpy.context)
        assert len(checked) == times
