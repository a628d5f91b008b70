# SPDX-License-Identifier: GPL-3.0-or-later
"""Run folder: its lock, its content after every outcome of a job, and checkpoints."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from irgspp.core import run_folder
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.io import run_files
from irgspp.core.io.file_lock import FileLock
from irgspp.core.io.run_files import check_claim
from irgspp.core.progress.protocol import Silent
from irgspp.core.progress.recorder import ProgressRecorder
from irgspp.core.run_folder import RunFolder, read_run, write_atomic
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings, preset


@pytest.fixture
def run(tmp_path):
    folder = RunFolder.open(tmp_path / "run", Settings(), "photos")
    yield folder
    folder.close()


def reopen(folder, settings=None, dataset="photos", **options):
    folder.close()
    return RunFolder.open(folder.path, settings or Settings(), dataset, **options)


def events(folder):
    return [json.loads(line) for line in (folder.path / "events.jsonl").read_text().splitlines()]


def test_new_run_records_settings_and_versions(run):
    state = read_run(run.path)
    assert state["status"] == "running"
    assert state["settings"]["data"]["resolution"] == Settings().data.resolution
    assert state["seed"] == 0
    assert state["versions"]["numpy"] == np.__version__


def test_another_run_is_not_touched(run):
    before = (run.path / "run.json").read_bytes()
    with pytest.raises(InputError, match=r"--resume.*--overwrite"):
        reopen(run)
    assert (run.path / "run.json").read_bytes() == before


def test_foreign_folder_is_refused_even_with_overwrite(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="not a run folder"):
        RunFolder.open(tmp_path, Settings(), "photos", overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]


def test_overwrite_removes_the_run_and_nothing_else(run):
    (run.path / "mesh.ply").write_text("old")
    (run.path / "notes.txt").write_text("mine")
    run.save("first_stage", {"step": 1})
    again = reopen(run, overwrite=True)
    assert not (run.path / "mesh.ply").exists()
    assert again.load("first_stage") is None
    assert (run.path / "notes.txt").read_text() == "mine"
    again.close()


@pytest.mark.parametrize("inside", [False, True])
def test_file_in_the_way(tmp_path, inside):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        RunFolder.open(tmp_path / "file" / "run" if inside else tmp_path / "file", Settings(), "photos")


def test_not_writable(tmp_path, monkeypatch):
    monkeypatch.setattr(run_files.os, "access", lambda *_: False)
    with pytest.raises(InputError, match="not writable"):
        RunFolder.open(tmp_path / "run", Settings(), "photos")
    assert not (tmp_path / "run").exists()


def test_folder_that_can_not_be_made_is_an_input_error(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(run_folder.Path, "mkdir", refuse)
    with pytest.raises(InputError, match="Permission denied"):
        RunFolder.open(tmp_path / "run", Settings(), "photos")


def test_run_in_use_by_another_process_is_refused(run):
    run.close()
    code = "from irgspp.core.io.file_lock import FileLock; held = FileLock('.lock'); print('held', flush=True); input()"
    command = [sys.executable, "-P", "-c", code]
    holder = subprocess.Popen(command, cwd=run.path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(InputError, match="in use"):
        RunFolder.open(run.path, Settings(), "photos", resume=True)
    holder.kill()  # as after kill -9: the lock is free at once
    holder.communicate()
    FileLock(run.path / ".lock").release()


def test_resume_keeps_finished_phases(run):
    with run.timed("first stage"):
        pass
    run.skip("scene.blend", "no bpy")
    again = reopen(run, resume=True)
    assert again.finished("first stage")
    assert not again.finished("surface")
    assert again.state["skipped"] == [{"what": "scene.blend", "why": "no bpy"}]
    again.close()


@pytest.mark.parametrize(
    ("settings", "dataset", "words"), [(preset("draft"), "photos", "first.iterations"), (Settings(), "other", "dataset")]
)
def test_resume_with_other_settings_is_refused(run, settings, dataset, words):
    with pytest.raises(InputError, match=words):
        reopen(run, settings, dataset, resume=True)
    reopen(run, resume=True).close()  # the refusal has let go of the folder


def with_sphere(*values):
    return with_overrides(Settings(), [f"capture.centre={','.join(map(str, values[:3]))}", f"capture.radius={values[3]}"])


def test_another_sphere_begins_anew_with_the_capture(run):
    with run.timed("capture"), run.timed("first stage"):
        pass
    for folder in ("capture", "textures"):
        (run.path / folder).mkdir()
        (run.path / folder / "a").touch()
    (run.path / "mesh.ply").touch()
    cut = []
    again = reopen(run, with_sphere(0, 0, 1, 0.5), resume=True, recut=lambda: cut.append((run.path / "mesh.ply").exists()))
    assert cut == [True] and (run.path / "capture" / "a").exists()
    assert not (run.path / "mesh.ply").exists() and not (run.path / "textures").exists()
    assert not again.finished("capture") and not again.finished("first stage")
    state = read_run(run.path)
    assert state["settings"]["capture"]["radius"] == 0.5 and "recut" not in state
    reopen(again, with_sphere(0, 0, 1, 0.5), resume=True, recut=lambda: cut.append(1)).close()
    assert cut == [True]  # the same sphere


def test_a_sphere_that_is_refused_leaves_the_run(run):
    (run.path / "mesh.ply").touch()
    run.write()
    before = (run.path / "run.json").read_bytes()

    def refuse():
        raise InputError("sphere", "holds no point")

    with pytest.raises(InputError, match="holds no point"):
        reopen(run, with_sphere(0, 0, 1, 0.5), resume=True, recut=refuse)
    assert (run.path / "run.json").read_bytes() == before and (run.path / "mesh.ply").exists()
    with pytest.raises(InputError, match=r"other options \(first.iterations"):
        reopen(run, with_overrides(with_sphere(0, 0, 1, 0.5), ["first.iterations=9"]), resume=True, recut=refuse)
    reopen(run, resume=True).close()


def test_a_run_resumes_after_its_project_was_moved(tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    (old / "photos").mkdir(parents=True)
    folder = RunFolder.open(old / "run", Settings(), str(old / "photos"))
    folder.close()
    (new / "photos").mkdir(parents=True)
    with pytest.raises(InputError, match="dataset"):  # a copy: which of the two is meant?
        RunFolder.open(old / "run", Settings(), str(new / "photos"), resume=True)
    old.rename(tmp_path / "moved")
    again = RunFolder.open(tmp_path / "moved" / "run", Settings(), str(tmp_path / "moved" / "photos"), resume=True)
    again.close()
    assert read_run(tmp_path / "moved" / "run")["dataset"] == str(tmp_path / "moved" / "photos")


def test_broken_run_json(run):
    (run.path / "run.json").write_text("{")
    with pytest.raises(InputError, match=r"run\.json: is broken"):
        reopen(run, resume=True)


def test_every_outcome_becomes_the_status(run):
    with run.job():
        pass
    assert read_run(run.path)["status"] == "done"
    with pytest.raises(Cancelled), run.job():
        raise Cancelled("stop")
    assert read_run(run.path)["status"] == "cancelled"
    with pytest.raises(ZeroDivisionError), run.job():
        _ = 1 / 0
    state = read_run(run.path)
    assert (state["status"], state["error"]) == ("failed", "ZeroDivisionError: division by zero")
    assert "Traceback" in (run.path / "log.txt").read_text()


def test_phase_that_fails_is_timed_but_not_finished(run):
    with pytest.raises(RuntimeError), run.timed("surface"):
        raise RuntimeError
    assert not run.finished("surface")
    with run.timed("surface"):
        pass
    phase = read_run(run.path)["phases"]["surface"]
    assert phase["finished"]
    assert phase["peak_memory"] > 1 << 20


def test_checkpoint_round_trip(run):
    generator = torch.Generator().manual_seed(3)
    nested = {"x": torch.arange(3.0), "y": np.eye(2)}
    state = {"step": 4, "name": "a", "nested": nested, "pair": (1.5, [True, None]), "rng": generator.get_state()}
    run.save("first_stage", state)
    back = run.load("first_stage")
    assert (back["step"], back["name"], back["pair"]) == (4, "a", (1.5, [True, None]))
    assert torch.equal(back["nested"]["x"], state["nested"]["x"])
    assert torch.equal(back["nested"]["y"], torch.eye(2, dtype=torch.float64))
    generator.set_state(back["rng"])
    assert torch.equal(torch.rand(3, generator=generator), torch.rand(3, generator=torch.Generator().manual_seed(3)))
    assert [p.name for p in (run.path / "checkpoint").iterdir()] == ["first_stage.pt"]


def test_damaged_checkpoint_is_an_input_error(run):
    assert run.load("first_stage") is None
    run.save("first_stage", {"x": torch.zeros(1000)})
    path = run.path / "checkpoint" / "first_stage.pt"
    for data in (path.read_bytes()[:700], b"", b"not a checkpoint"):
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"first_stage\.pt"):
            run.load("first_stage")


def test_interrupted_save_leaves_the_old_checkpoint(run, monkeypatch):
    run.save("first_stage", {"step": 1})
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(OSError, match="No space"):
        run.save("first_stage", {"step": 2})
    assert run.load("first_stage") == {"step": 1}
    with pytest.raises(OSError, match="No space"):
        write_atomic(run.path / "run.json", b"half")
    assert read_run(run.path)["status"] == "running"


def test_recorder_writes_events_and_obeys_the_files(run):
    recorder = ProgressRecorder(run, Silent())
    recorder.phase("first stage", 2)
    assert not recorder.cancelled
    (run.path / "finish").touch()
    assert recorder.finish_early
    recorder.step(2, loss=0.5, psnr=float("inf"))
    recorder.message("hello")
    recorder.phase("surface", 1)
    assert not recorder.finish_early
    (run.path / "cancel").touch()
    assert recorder.cancelled
    first, last, message, second = events(run)
    assert (first["phase"], first["step"], first["of"]) == ("first stage", 0, 2)
    assert (last["step"], last["loss"], last["psnr"]) == (2, 0.5, None)
    assert message["message"] == "hello"
    assert second["phase"] == "surface"
    assert "hello" in (run.path / "log.txt").read_text()
    again = reopen(run, resume=True)
    assert not ProgressRecorder(again, Silent()).cancelled
    again.close()


def test_killed_before_run_json_was_written(tmp_path):
    """The folder has only the lock and half a run.json: a new run may be made in it."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".lock").touch()
    (tmp_path / "run" / ".run.part.json").write_text('{"sta')
    for resume, overwrite in ((False, False), (True, False), (False, True)):
        check_claim(tmp_path / "run", resume, overwrite)
    RunFolder.open(tmp_path / "run", Settings(), "photos", resume=True).close()


@pytest.mark.parametrize("cut", ["rmtree", "unlink"])
def test_killed_while_another_run_was_being_replaced(run, monkeypatch, cut):
    """Files left of the old run must not pass for the new one's: it was finished, and its checkpoint is of other settings."""
    run.save("first_stage", {"step": 1})
    run.record("first stage", 1.0, 1, finished=True)
    (run.path / "mesh.ply").write_text("old")

    def killed(*_, **__):
        raise SystemError

    with monkeypatch.context() as patch:
        patch.setattr(run_folder.shutil if cut == "rmtree" else run_folder.Path, cut, killed)
        with pytest.raises(SystemError):
            reopen(run, preset("draft"), overwrite=True)
    again = RunFolder.open(run.path, preset("draft"), "photos", resume=True)
    assert not again.finished("first stage") and again.load("first_stage") is None
    assert not (run.path / "mesh.ply").exists() and "replaces" not in read_run(run.path)
    again.close()
