# SPDX-License-Identifier: GPL-3.0-or-later
"""Phases of the reconstruction in order, the run folder after every outcome, and resumed runs, with quick stand-ins for the stages."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from irgspp.core import pipeline
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.machine.blender_process import NoBlender
from irgspp.core.progress.protocol import Silent
from irgspp.core.rendering import gbuffer_cache
from irgspp.core.rendering.gbuffer_cache import GBufferCache
from irgspp.core.run_folder import read_run
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from stand_in_stages import ALL, TRIANGLE, Result, Stages, camera


@pytest.fixture
def stages(monkeypatch):
    return Stages(monkeypatch)


def test_phases_run_in_order_and_are_recorded(tmp_path, stages):
    run = pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings())
    assert stages.ran == ALL
    state = read_run(run)
    assert state["status"] == "done"
    assert list(state["phases"]) == ["read", "first stage", *ALL[1:]]
    assert all(phase["finished"] and phase["peak_memory"] > 0 for phase in state["phases"].values())
    assert state["training"] == {"loss": 0.25, "psnr": 30.0}
    assert len(stages.times) == 1 and 0 < stages.times[0] <= sum(phase["seconds"] for phase in state["phases"].values())
    log = (run / "log.txt").read_text()
    assert "b.png" in log and "takes about" in log and "no masks: the surroundings are reconstructed, too" in log
    with np.load(run / "previews" / "shape.npz") as shape:
        np.testing.assert_array_equal(shape["faces"], TRIANGLE.faces)
    assert not (run / "checkpoint").exists()
    assert {json.loads(line).get("phase") for line in (run / "events.jsonl").read_text().splitlines()} >= {"first stage"}


@pytest.mark.parametrize(("stop", "again"), [("train", ["train again", *ALL[1:]]), *((ALL[i], ALL[i:]) for i in range(1, len(ALL)))])
def test_cancelled_run_resumes_where_it_stopped(tmp_path, stages, stop, again):
    stages.stop = stop
    with pytest.raises(Cancelled):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings())
    assert read_run(tmp_path / "run")["status"] == "cancelled"
    stages.stop, stages.ran[:] = None, []
    pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings(), resume=True)
    assert stages.ran == again
    assert read_run(tmp_path / "run")["status"] == "done"
    assert not stages.times  # a part of the work was done before


def test_kill_between_the_files_of_the_second_stage_keeps_those_of_the_first(tmp_path, stages, monkeypatch):
    """The new file is written, the others are not yet: the second stage must not start from that file."""
    save = Result.save

    def killed(self, folder):
        save(self, folder)
        if self.stage == "second":
            raise KeyboardInterrupt

    monkeypatch.setattr(Result, "save", killed)
    with pytest.raises(KeyboardInterrupt):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings())
    assert (tmp_path / "run" / "gaussians.ply").read_text() == "second"
    assert not read_run(tmp_path / "run")["phases"]["second stage"]["finished"]
    monkeypatch.setattr(Result, "save", save)
    stages.ran[:] = []
    pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings(), resume=True)  # the stand-in checks its input
    assert stages.ran == ALL[2:]


def test_missing_checkpoint_is_an_input_error(tmp_path, stages):
    stages.stop = "second stage"
    with pytest.raises(Cancelled):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings())
    os.unlink(tmp_path / "run" / "checkpoint" / "geometry.pt")
    with pytest.raises(InputError, match=r"geometry\.pt.*--overwrite"):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings(), resume=True)


def test_failure_is_recorded(tmp_path, stages):
    stages.fail = "surface"
    with pytest.raises(IrgsppError, match="no surface"):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings())
    state = read_run(tmp_path / "run")
    assert (state["status"], state["error"]) == ("failed", "IrgsppError: no surface")
    assert not state["phases"]["surface"]["finished"]


def test_error_of_a_child_process_after_a_cancel_is_a_cancel(tmp_path, stages, monkeypatch):
    progress = Silent()

    def killed(*_):
        progress.cancelled = True
        raise IrgsppError("Blender ended with status -2")

    monkeypatch.setattr(pipeline, "write_blend", killed)
    with pytest.raises(Cancelled):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings(), progress=progress)


def test_cancel_between_phases(tmp_path, stages):
    progress = Silent()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings(), progress=progress)
    assert stages.ran == []


def test_without_blender_the_scene_is_skipped_with_a_reason(tmp_path, stages, monkeypatch):
    def missing(*_):
        raise NoBlender("no Blender here")

    monkeypatch.setattr(pipeline, "write_blend", missing)
    run = pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings())
    assert read_run(run)["skipped"] == [{"what": "scene.blend", "why": "no Blender here"}]
    assert read_run(run)["status"] == "done"
    assert stages.ran[-1] == "contact sheet"


def test_bad_dataset_writes_nothing_and_keeps_the_old_run(tmp_path, stages, monkeypatch):
    pipeline.reconstruct(Path("photos"), tmp_path / "old", Settings())
    before = sorted(p.name for p in (tmp_path / "old").iterdir())

    def broken(path, settings, progress):
        raise InputError(path, "no such folder")

    monkeypatch.setattr(pipeline, "load_dataset", broken)
    with pytest.raises(InputError):
        pipeline.reconstruct(Path("photos"), tmp_path / "new", Settings())
    with pytest.raises(InputError):
        pipeline.reconstruct(Path("photos"), tmp_path / "old", Settings(), overwrite=True)
    assert not (tmp_path / "new").exists()
    assert sorted(p.name for p in (tmp_path / "old").iterdir()) == before


@pytest.mark.parametrize("words", [[], ["surface.texture=300"]])
def test_texture_size_is_recorded_and_stays_that_of_the_first_start(tmp_path, monkeypatch, words):
    settings = with_overrides(Settings(), words)
    stages, size = Stages(monkeypatch, settings), settings.surface.texels
    stages.stop = "second stage"
    with pytest.raises(Cancelled):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", settings)
    state = read_run(tmp_path / "run")
    assert state["textures"]["size"] == size and state["settings"]["surface"]["texture"] == settings.surface.texture
    assert f"textures of {size} texels: {state['textures']['why']}" in (tmp_path / "run" / "log.txt").read_text()
    monkeypatch.setattr(pipeline, "choose_texture_size", None)  # which would find other memory
    stages.stop = None
    pipeline.reconstruct(Path("photos"), tmp_path / "run", settings, resume=True)


def test_settings_are_checked_before_anything_else(tmp_path, stages):
    with pytest.raises(InputError, match="cuda"):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", with_overrides(Settings(), ["device=cuda"]))
    assert not (tmp_path / "run").exists()


def test_gbuffer_cache_keeps_the_views_that_fit(monkeypatch):
    rendered = []
    monkeypatch.setattr(gbuffer_cache, "render_gbuffer", lambda _, camera, **options: rendered.append(camera.width) or camera.width)
    views = GBufferCache(None, [camera(w) for w in (4, 5, 6)], memory=4 * 4 * gbuffer_cache.FLOATS * 4)
    assert list(views) == [4, 5, 6]
    assert list(views) == [4, 5, 6]
    assert rendered == [4, 5, 6, 5, 6]
    assert (views[-1], views[1:]) == (6, [5, 6])
    with pytest.raises(IndexError):
        views[3]
