# SPDX-License-Identifier: GPL-3.0-or-later
"""Phases of the reconstruction in order, the run folder after every outcome, and resumed runs, with quick stand-ins for the stages."""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from irgspp.core import pipeline
from irgspp.core.errors import Cancelled, InputError, IrgsppError
from irgspp.core.machine.blender_process import NoBlender
from irgspp.core.progress.protocol import Silent
from irgspp.core.rendering import gbuffer_cache
from irgspp.core.rendering.gbuffer_cache import GBufferCache
from irgspp.core.run_folder import read_run
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings


def camera(width=4, height=4):
    return Camera(width, height, 4.0, 4.0, 2.0, 2.0, np.eye(4))


def small_dataset(path, settings, progress):
    view = View("a", camera(), Path("a.png"), np.zeros((4, 4, 3), np.float32), None)
    return Dataset(path, "transforms", [view] * 3, [], Bound((0, 0, 0), 1.0), np.eye(4), warnings=["b.png: truncated, left out"])


TRIANGLE = Surface(np.eye(3) / 3, np.eye(3), np.array([[0, 1, 2]]), 0.1)


class Result:
    """Stand-in for a reconstruction: its file names the stage that made it."""

    bound = Bound((0, 0, 0), 1.0)

    def __init__(self, stage):
        self.stage = stage

    def save(self, folder):
        folder.mkdir(exist_ok=True)
        (folder / "gaussians.ply").write_text(self.stage)

    def surface_samples(self):
        return self.stage

    def to(self, device):
        return self


class Stages:
    """Stand-ins for the stages: they record their name and write a file; `stop` names one that is cancelled, `fail` one that fails."""

    def __init__(self, monkeypatch):
        self.ran, self.stop, self.fail = [], None, None
        monkeypatch.setattr(pipeline, "load_dataset", small_dataset)
        monkeypatch.setattr(pipeline, "train", self.train)
        monkeypatch.setattr(pipeline, "extract_geometry", self.extract)
        monkeypatch.setattr(pipeline, "solve_second_stage", self.second_stage)
        monkeypatch.setattr(pipeline, "textured_mesh", self.texture)
        monkeypatch.setattr(pipeline, "open_relighter", lambda run, reconstruction, *_: reconstruction.stage)
        monkeypatch.setattr(Reconstruction, "load", staticmethod(lambda run: Result((run / "gaussians.ply").read_text())))
        monkeypatch.setattr(pipeline, "save_mesh_files", lambda mesh, run: (run / "mesh.ply").write_text("mesh"))
        monkeypatch.setattr(pipeline, "write_blend", self.blend)
        monkeypatch.setattr(pipeline, "contact_sheet", self.sheet)

    def record(self, name):
        self.ran.append(name)
        if name == self.stop:
            raise Cancelled("asked")
        if name == self.fail:
            raise IrgsppError("no surface")

    def train(self, dataset, settings, progress, checkpoint, deadline, device, resident):
        assert (deadline is None) == (settings.time is None)
        progress.phase("first stage", 2)
        progress.step(1, loss=0.5, psnr=20.0)
        begun = checkpoint.load("first_stage")
        checkpoint.save("first_stage", {"step": 1})
        self.record("train" if begun is None else "train again")
        progress.step(2, loss=0.25, psnr=30.0)
        return Result("first"), 0.5

    def extract(self, views, samples, bound, settings, progress, masks):
        assert len(views) == 3
        assert samples == "first"
        assert masks is None  # the images have no alpha
        self.record("geometry")
        return TRIANGLE

    def second_stage(self, first, surface, dataset, settings, progress, deadline):
        assert first.stage == "first"
        assert settings == Settings() and deadline is None  # no time was set
        self.check(surface)
        self.record("second stage")
        return Result("second"), 1.0

    def texture(self, surface, views, samples, settings, progress):
        assert samples == "second"
        assert len(views) == 3
        self.check(surface)
        self.record("surface")
        return SimpleNamespace(textures={})

    def sheet(self, dataset, relighter, path, progress):
        assert relighter == "second"
        self.record("contact sheet")

    def check(self, surface):
        """Assert that the surface has exactly the numbers of TRIANGLE."""
        for name in ("vertices", "normals", "faces"):
            np.testing.assert_array_equal(getattr(surface, name), getattr(TRIANGLE, name), strict=True)
        assert surface.voxel == TRIANGLE.voxel

    def blend(self, run, target, material, progress):
        assert (run / "mesh.ply").exists()
        assert (run / "cameras.json").exists()
        assert material == "textures"
        self.record("scene")


@pytest.fixture
def stages(monkeypatch):
    return Stages(monkeypatch)


ALL = ["train", "geometry", "second stage", "surface", "scene", "contact sheet"]


def test_phases_run_in_order_and_are_recorded(tmp_path, stages):
    run = pipeline.reconstruct(Path("photos"), tmp_path / "run", Settings())
    assert stages.ran == ALL
    state = read_run(run)
    assert state["status"] == "done"
    assert list(state["phases"]) == ["read", "first stage", *ALL[1:]]
    assert all(phase["finished"] and phase["peak_memory"] > 0 for phase in state["phases"].values())
    assert state["training"] == {"loss": 0.25, "psnr": 30.0}
    assert "b.png" in (run / "log.txt").read_text()
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


def test_settings_are_checked_before_anything_else(tmp_path, stages):
    with pytest.raises(InputError, match="cuda"):
        pipeline.reconstruct(Path("photos"), tmp_path / "run", with_overrides(Settings(), ["device=cuda"]))
    assert not (tmp_path / "run").exists()


def test_gbuffer_cache_keeps_the_views_that_fit(monkeypatch):
    rendered = []
    monkeypatch.setattr(gbuffer_cache, "render_gbuffer", lambda _, camera: rendered.append(camera.width) or camera.width)
    views = GBufferCache(None, [camera(w) for w in (4, 5, 6)], memory=4 * 4 * 13 * 4)
    assert list(views) == [4, 5, 6]
    assert list(views) == [4, 5, 6]
    assert rendered == [4, 5, 6, 5, 6]
    assert (views[-1], views[1:]) == (6, [5, 6])
    with pytest.raises(IndexError):
        views[3]
