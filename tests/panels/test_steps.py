# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbered steps: which is done, which is next, and why one can't be done yet."""

import time
from types import SimpleNamespace

import bpy
import pytest
from irgspp.irgspp_addon.engine import process as engine
from irgspp.panels import capture_state, export, result, run_state, steps
from panel_states import add_job, finished_run
from panel_states import settings as settings
from recording_layout import RecordingLayout, draw

ALL = range(1, 6)


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """An engine that is said to work, and folders that are looked at again."""
    monkeypatch.setattr(engine, "status", lambda: engine.Status("ok", "Engine 1"))
    forget()


def forget() -> None:
    capture_state.forget()
    run_state._known.clear()


def states() -> list[str]:
    forget()
    return [steps.step_state(bpy.context, step) for step in ALL]


def posed(folder):
    (folder / "images").mkdir(parents=True)
    (folder / "transforms.json").write_text("{}")
    return folder


def test_the_first_step_is_next_in_an_empty_scene(settings):
    assert states() == ["next", "later", "later", "later", "later"]
    assert steps.obstacle(bpy.context, steps.PHOTOGRAPHS) == ""
    assert {steps.obstacle(bpy.context, step) for step in (2, 3)} == {"First choose photographs."}
    for panel in (result.IRGSPP_PT_result, export.IRGSPP_PT_export):
        assert draw(panel).words.startswith("First reconstruct")


def test_known_cameras_lead_to_the_reconstruction(settings, tmp_path):
    settings.dataset = str(posed(tmp_path / "photos"))
    assert states() == ["done", "done", "next", "later", "later"]


def test_bare_photographs_lead_to_their_cameras_and_can_be_reconstructed(settings, tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").touch()
    settings.dataset = str(tmp_path / "photos")
    assert states() == ["done", "next", "open", "later", "later"]
    add_job(tmp_path / "photos_irgspp", state="running", made=time.time())  # it finds the cameras by itself
    assert states()[1:3] == ["open", "next"]


def test_a_finished_run_leads_to_looking_and_export(settings, tmp_path):
    settings.dataset = str(posed(tmp_path / "photos"))
    finished_run(tmp_path / "photos_irgspp")
    assert states() == ["done", "done", "done", "next", "open"]
    settings.dataset, settings.run = "", str(tmp_path / "photos_irgspp")  # opened without its photographs
    assert states() == ["open", "later", "done", "next", "open"]


def test_photographs_that_are_gone_and_a_missing_engine_are_told(settings, tmp_path, monkeypatch):
    settings.dataset = str(tmp_path / "gone")
    assert states() == ["next", "later", "later", "later", "later"]
    settings.dataset = str(posed(tmp_path / "photos"))
    monkeypatch.setattr(engine, "status", lambda: engine.Status("missing", "No engine"))
    assert states() == ["done", "done", "next", "later", "later"]
    assert steps.obstacle(bpy.context, steps.RECONSTRUCT) == "First set up the engine above."


def test_the_header_shows_the_state(settings, tmp_path):
    def header(step: int) -> tuple[str, bool]:
        forget()
        layout = RecordingLayout()
        steps.StepPanel.draw_header(SimpleNamespace(layout=layout, step=step), bpy.context)
        ((_, _, icon),) = layout.drawn
        return icon, layout.active

    settings.dataset = str(posed(tmp_path / "photos"))
    assert [header(step) for step in (1, 3, 5)] == [("CHECKMARK", True), ("RADIOBUT_ON", True), ("RADIOBUT_OFF", False)]
