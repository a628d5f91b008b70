# SPDX-License-Identifier: GPL-3.0-or-later
"""Run folders of version 0.1, with its names of phases and settings: read, resumed, and refused."""

import json

import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.progress.protocol import Silent
from irgspp.core.run_folder import RunFolder, read_run
from irgspp.core.settings.overrides import to_dict
from irgspp.core.settings.schema import Settings, preset


@pytest.fixture
def old_run(tmp_path):
    """A run of version 0.1 that was killed in its second stage, with the phases and settings of that version in run.json."""
    path = tmp_path / "old"
    (path / "checkpoint").mkdir(parents=True)
    settings = to_dict(Settings())
    settings["reflective"], settings["transport"] = settings.pop("first"), settings.pop("second")
    settings["skip"] = {"outside": "auto", "trials": "auto", "constants": "auto", "open": "auto", "kept": "auto"}
    phases = {
        name: {"seconds": 2.0, "peak_memory": 1 << 20, "finished": finished}
        for name, finished in (("read", True), ("reflective", True), ("geometry", True), ("transport", False))
    }
    state = {"status": "running", "error": None, "versions": {}, "dataset": "photos", "settings": settings, "seed": 0}
    state |= {"phases": phases, "pace": {"first": 1.0}, "skipped": [], "training": {"psnr": 30.0}}
    (path / "run.json").write_text(json.dumps(state))
    torch.save({"step": 4}, path / "checkpoint" / "reflective.pt")
    return path


def test_old_run_is_read_with_the_phase_names_of_today(old_run):
    phases = read_run(old_run)["phases"]
    finished = {name: phase["finished"] for name, phase in phases.items()}
    assert finished == {"read": True, "first stage": True, "geometry": True, "second stage": False}
    assert phases["first stage"] == {"seconds": 2.0, "peak_memory": 1 << 20, "finished": True}


def test_old_run_resumes(old_run):
    folder = RunFolder.open(old_run, Settings(), "photos", resume=True)
    assert folder.finished("first stage") and folder.finished("geometry") and not folder.finished("second stage")
    assert folder.spent == 8.0
    assert [path.name for path in (old_run / "checkpoint").iterdir()] == ["first_stage.pt"]
    assert folder.load("first_stage") == {"step": 4}
    ran = []
    for name in ("first stage", "second stage"):
        folder.run_phase(name, lambda name=name: ran.append(name), Silent())
    assert ran == ["second stage"] and read_run(old_run)["phases"]["second stage"]["finished"]
    folder.close()
    RunFolder.open(old_run, Settings(), "photos", resume=True).close()  # and again, from what it has written


def test_old_run_with_other_settings_is_refused_and_stays_as_it_is(old_run):
    before = (old_run / "run.json").read_bytes()
    with pytest.raises(InputError, match=r"first\.iterations"):
        RunFolder.open(old_run, preset("draft"), "photos", resume=True)
    assert (old_run / "run.json").read_bytes() == before
    assert (old_run / "checkpoint" / "reflective.pt").is_file()
