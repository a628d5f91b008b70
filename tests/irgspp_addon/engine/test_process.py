# SPDX-License-Identifier: GPL-3.0-or-later
"""Choice of the engine's Python, its status, and the messages for engines that do not work."""

import json
import os
import subprocess
import sys

import bpy
import pytest
from blender_side import ENGINE, ROOT, warm
from engine_jobs import registry as registry
from irgspp.core.errors import InputError
from irgspp.core.machine.version import LIBRARIES, VERSION, numbers
from irgspp.irgspp_addon.engine import managed
from irgspp.irgspp_addon.engine import process as engine
from irgspp.irgspp_addon.jobs import engine_check, queue
from irgspp.irgspp_addon.preferences_page import IRGSPP_Preferences

pytestmark = pytest.mark.usefixtures("registry")
tomllib = pytest.importorskip("tomllib")


@pytest.fixture
def chosen(monkeypatch):
    """Register the extension's preferences, as in an installed extension."""
    monkeypatch.delenv("IRGSPP_PYTHON", raising=False)
    bpy.utils.register_class(IRGSPP_Preferences)
    addon = bpy.context.preferences.addons.new()
    addon.module = IRGSPP_Preferences.bl_idname
    yield addon.preferences
    bpy.context.preferences.addons.remove(addon)
    bpy.utils.unregister_class(IRGSPP_Preferences)


def fake_python(path, text, status=0):
    path.write_text(f"#!/bin/sh\n{text}\nexit {status}\n")
    path.chmod(0o755)
    return path


def test_versions_agree_with_the_packages_own_description():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == VERSION
    always = [
        word for word in project["dependencies"] if not word.startswith("bpy") and ";" not in word
    ]  # not those of some platforms only
    needed = dict(word.split(">=") for word in always)
    assert needed == dict(LIBRARIES.values())


def test_versions_compare_as_numbers():
    assert numbers("2.13.0+cpu") == (2, 13, 0) > numbers("2.5")
    assert numbers("4.11.0.86") > numbers("4.10")
    assert numbers("1.0rc1") == (1,)


def test_engine_that_works_is_remembered(monkeypatch):
    monkeypatch.setenv("IRGSPP_PYTHON", ENGINE)
    assert engine.status().state == "unknown" and engine.status().usable
    found = engine.check()
    assert found.state == "ok" and VERSION in found.text and found.devices["cpu"]["threads"] > 0
    engine._known.clear()  # as after a restart
    assert engine.status() == found
    engine.forget_checks()
    assert engine.status().state == "unknown"


def test_check_as_a_job(monkeypatch):
    monkeypatch.setenv("IRGSPP_PYTHON", warm())
    monkeypatch.setattr(queue, "ON_END", engine_check.ON_END)
    job = engine_check.check_in_background()
    assert engine_check.check_in_background() is job
    queue.wait(job, 120)
    assert engine.status().state == "ok" and queue.all_jobs() == []


@pytest.mark.skipif(sys.platform == "win32", reason="scripts of a shell")
@pytest.mark.parametrize(
    ("command", "status", "state", "words"),
    [
        (f"echo '{json.dumps({'irgspp': '0.0.1', 'python': '3.11.7', 'cpu': {'name': 'c'}, 'cuda': []})}'", 0, "version", "version 0.0.1"),
        ("echo 'irgspp: this is Python 3.8, 3.11 or newer is needed' >&2", 2, "version", "Python 3.8"),
        ('echo "Traceback" >&2; echo "ModuleNotFoundError: No module named \'numpy\'" >&2', 1, "broken", "numpy"),
        ("echo nonsense", 0, "broken", "no answer"),
        ("echo '[]'", 0, "broken", "no answer"),
        ("", 9, "broken", "status 9"),
    ],
)
def test_engines_that_do_not_work(tmp_path, monkeypatch, command, status, state, words):
    monkeypatch.setenv("IRGSPP_PYTHON", str(fake_python(tmp_path / "python", command, status)))
    for function in (engine.check, engine.status):
        assert function().state == state and words in function().text and "\n" not in function().text
    if status:
        monkeypatch.setattr(queue, "ON_END", engine_check.ON_END)
        engine.forget_checks()
        queue.wait(engine_check.check_in_background(), 300)
        assert engine.status().state == state and words in engine.status().text
    with pytest.raises(InputError, match=words):
        queue.start("render", "r", None, ["render"])
    assert queue.all_jobs() == []


def test_no_engine_at_all(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("IRGSPP_PYTHON", str(tmp_path / "none"))
    assert engine.status().state == engine.check().state == "missing"
    assert engine_check.check_in_background() is None
    assert engine.run_engine(["devices"]) == 2
    assert str(tmp_path / "none") in capfd.readouterr().err


def test_a_file_that_is_not_a_program(tmp_path, monkeypatch):
    (tmp_path / "python").write_text("no program")
    monkeypatch.setenv("IRGSPP_PYTHON", str(tmp_path / "python"))
    assert engine.check().state == "broken" and "can't be started" in engine.status().text
    engine.forget_checks()
    job = queue.start("render", "r", None, ["render"])
    assert job.state == "failed" and "can't be started" in job.error


def test_preferences_choose_the_python(tmp_path, chosen):
    assert chosen.engine_kind == "INTERPRETER" and engine.engine_python() == sys.executable
    chosen.engine_kind = "EXISTING"
    assert engine.status().state == "missing" and "choose one" in engine.status().text
    with pytest.raises(InputError, match="no Python is chosen"):
        engine.engine_command("devices")
    chosen.engine_kind = "INTERPRETER"
    (tmp_path / "env").mkdir()
    chosen.engine_python = str(tmp_path / "env")
    assert chosen.engine_kind == "EXISTING"  # choosing a path also chooses this kind
    assert engine.engine_python() == str(managed.python_of(tmp_path / "env"))
    chosen.engine_kind = "MANAGED"
    assert engine.engine_python() == str(managed.python())
    assert engine.status().state == "missing" and "install one" in engine.status().text


def test_managed_engine_of_another_lock(chosen):
    chosen.engine_kind = "MANAGED"
    managed.python().parent.mkdir(parents=True)
    os.symlink(ENGINE, managed.python())
    assert engine.status().state == "version"  # incomplete, or from an older version
    (managed.folder() / managed.MARKER).write_text(json.dumps({"lock": managed.lock_digest()}))
    assert engine.status().state == "unknown"
    (managed.folder() / managed.MARKER).write_text(json.dumps({"lock": "other"}))
    assert engine.status().state == "version" and "install it again" in engine.status().text


def test_variables_of_blenders_python_are_removed(monkeypatch, chosen):
    for name in ("PYTHONHOME", "PYTHONPATH"):
        monkeypatch.setenv(name, "/somewhere")
    assert engine.engine_environment()["PYTHONPATH"] == "/somewhere"  # Blender's Python is the engine
    chosen.engine_python = ENGINE
    assert not {"PYTHONHOME", "PYTHONPATH"} & set(engine.engine_environment())


def test_old_python_is_reported_by_the_launcher(tmp_path):
    """An old Python must be able to parse the launcher."""
    code = f"import sys, runpy; sys.version_info = (3, 8, 1); runpy.run_path({str(engine.LAUNCHER)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.strip()) == (2, "irgspp: this is Python 3.8, 3.11 or newer is needed")


def test_environment_without_a_library_is_reported(tmp_path):
    """The interpreter has none of the engine's libraries."""
    words = [sys.executable, "-I", "-S", str(engine.LAUNCHER), "__main__", "devices", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    found = engine.check_result(done.returncode, done.stdout, done.stderr)
    assert found.state == "broken" and "No module named" in found.text
