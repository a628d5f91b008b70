# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's page in the preferences: what it says about the managed engine, and the button that installs it."""

import json
import os

import bpy
import pytest
from blender_side import ENGINE
from engine_jobs import registry as registry
from irgspp.irgspp_addon.engine import managed
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.preferences_page import IRGSPP_Preferences, draw_preferences
from irgspp.panels import engine as engine_panel
from panel_states import add_job
from panel_states import settings as settings
from recording_layout import RecordingLayout, draw

pytestmark = pytest.mark.usefixtures("registry", "settings")


@pytest.fixture
def preferences(monkeypatch):
    """The preferences of an installed extension that uses the managed engine."""
    monkeypatch.delenv("IRGSPP_PYTHON", raising=False)
    addon = bpy.context.preferences.addons.new()
    addon.module = IRGSPP_Preferences.bl_idname
    addon.preferences.engine_kind = "MANAGED"
    yield addon.preferences
    bpy.context.preferences.addons.remove(addon)


def page(preferences):
    layout = RecordingLayout()
    draw_preferences(preferences, layout)
    return layout


def install(python):
    """Make the files of a complete managed engine, whose Python is a link as in a virtual environment."""
    managed.python().parent.mkdir(parents=True)
    os.symlink(python, managed.python())
    (managed.folder() / managed.MARKER).write_text(json.dumps({"lock": managed.lock_digest()}))


def test_the_page_does_not_send_the_user_to_itself(preferences):
    drawn = page(preferences)
    assert "No engine: install one here" in drawn.words and "Edit >" not in drawn.words
    assert drawn.buttons("irgspp.install_engine")[0].text == "Install Engine"
    assert "install one under Edit > Preferences" in draw(engine_panel.IRGSPP_PT_engine).words
    preferences.engine_kind = "EXISTING"
    assert "No engine: choose one here" in page(preferences).words


def test_an_engine_that_is_being_installed_is_not_called_missing(preferences, tmp_path):
    job = add_job(tmp_path, kind="install", state="running", message="Downloading torch")
    for drawn in (page(preferences), draw(engine_panel.IRGSPP_PT_engine)):
        assert "The engine is being installed" in drawn.words and "No engine" not in drawn.words
    preferences.engine_kind = "EXISTING"  # which the installation does not help
    assert "No engine: choose one here" in page(preferences).words
    preferences.engine_kind, job.state = "MANAGED", "failed"
    assert "No engine: install one here" in page(preferences).words


def test_an_installed_engine_without_its_python_is_not_called_missing(preferences, tmp_path):
    install(tmp_path / "removed" / "python")
    drawn = page(preferences)
    assert "the Python that it was made with is gone: install it again here" in drawn.words and "No engine" not in drawn.words
    assert drawn.buttons("irgspp.install_engine")[0].text == "Install Again"
    assert not engine.status().usable and "install it again under Edit > Preferences" in engine.status().text


def test_an_installed_engine_is_named(preferences):
    install(ENGINE)
    drawn = page(preferences)
    assert "Not checked yet" in drawn.words and "No engine" not in drawn.words
    assert drawn.buttons("irgspp.install_engine")[0].text == "Install Again"
