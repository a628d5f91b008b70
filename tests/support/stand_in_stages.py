# SPDX-License-Identifier: GPL-3.0-or-later
"""Quick stand-ins for the stages of a reconstruction."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from irgspp.core import pipeline
from irgspp.core.detail.report import DetailReport
from irgspp.core.errors import Cancelled, IrgsppError
from irgspp.core.scene.camera import Camera
from irgspp.core.scene.dataset import Bound, Dataset, View
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.surface import Surface
from irgspp.core.settings.schema import Settings
from irgspp.core.settings.sizes import with_sizes, with_texture_size
from irgspp.core.stages.second.solve import SecondStageResult

ALL = ["train", "geometry", "second stage", "surface", "scene", "contact sheet"]


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
    """Stand-ins for the stages: they record their name and write a file; `stop` names one that is cancelled, `fail` one that fails.

    Args:
        monkeypatch: puts them in place.
        settings: that the stages must receive.
        read: also stand in for the reading of datasets.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, settings: Settings = Settings(), read: bool = True):  # noqa: B008 (immutable)
        self.ran, self.stop, self.fail, self.settings = [], None, None, settings
        self.data, self.deadline, self.times = None, None, []  # that the first stage received; times of jobs that were kept
        if read:
            monkeypatch.setattr(pipeline, "load_dataset", small_dataset)
        monkeypatch.setattr(pipeline, "train", self.train)
        monkeypatch.setattr(pipeline, "extract_geometry", self.extract)
        monkeypatch.setattr(pipeline, "solve_second_stage", self.second_stage)
        monkeypatch.setattr(pipeline, "textured_mesh", self.texture)
        monkeypatch.setattr(pipeline, "UnwrapProcess", lambda mesh, texture, folder, tiles: SimpleNamespace(close=lambda: None))
        monkeypatch.setattr(pipeline, "detailed_by_dataset", lambda mesh, *_: (mesh, DetailReport(False, "stand-in")))
        monkeypatch.setattr(
            pipeline,
            "fitted_textures",
            lambda mesh, report, plain, why, tiles: (mesh, {"tiles": tiles, "size": plain, "texel": 1, "why": why}),
        )
        monkeypatch.setattr(pipeline, "open_relighter", lambda run, reconstruction, *_: reconstruction.stage)
        monkeypatch.setattr(Reconstruction, "load", staticmethod(lambda run: Result((run / "gaussians.ply").read_text())))
        monkeypatch.setattr(pipeline, "save_mesh_files", lambda mesh, run, tiles: (run / "mesh.ply").write_text("mesh"))
        monkeypatch.setattr(pipeline, "write_blend", self.blend)
        monkeypatch.setattr(pipeline, "contact_sheet", self.sheet)
        monkeypatch.setattr(pipeline, "radiance_psnr", lambda reconstruction, views: 30.0)
        monkeypatch.setattr(pipeline, "record_job", lambda settings, data, seconds: self.times.append(seconds))

    def record(self, name):
        self.ran.append(name)
        if name == self.stop:
            raise Cancelled("asked")
        if name == self.fail:
            raise IrgsppError("no surface")

    def train(self, dataset, settings, progress, checkpoint, deadline, device, resident):
        assert (deadline is None) == (settings.time is None)
        self.data, self.deadline = dataset, deadline
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

    def second_stage(self, first, surface, dataset, settings, progress, deadline, checkpoint):
        assert first.stage == "first"
        expected = with_texture_size(with_sizes(self.settings, None), self.settings.surface.texels)
        assert settings == expected and (deadline is None) == (settings.time is None)
        assert checkpoint.load("joint") is None
        self.check(surface)
        self.record("second stage")
        return SecondStageResult(Result("second"), 1.0)

    def texture(self, surface, views, samples, settings, progress, unwrapping, normal_source):
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
