# SPDX-License-Identifier: GPL-3.0-or-later
"""Reconstruction of photographs without cameras: the capture is the run's first phase, real from photographs to the dataset that is read.

Quick stand-ins take the place of the later stages.
"""

import json
import shutil

import numpy as np
import pytest
from irgspp.core import pipeline
from irgspp.core.capture import capture as capturing
from irgspp.core.capture.source import posed_dataset
from irgspp.core.errors import Cancelled, InputError
from irgspp.core.io.run_files import CAPTURE
from irgspp.core.machine import cpu_memory
from irgspp.core.progress.protocol import Silent
from irgspp.core.run_folder import read_run
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import Settings
from room_corner import cameras, take, textures
from stand_in_stages import ALL, Stages

SETTINGS = with_overrides(Settings(), ["capture.masks=off", "capture.resolution=128", "data.resolution=64"])
COUNT = 4  # photographs, of which one is held back for tests
CAPTURED = ("sparse/0/images.bin", "sparse/0/points3D.bin", "transforms.json", "exposures.json", "images/photo 0.png")


class Steps(Silent):
    """Progress that remembers its phases, and cancels after some steps of one phase."""

    def __init__(self, stop=None, after=0):
        self.phases, self._stop, self._after = [], stop, after

    def phase(self, name, steps):
        self.phases.append(name)

    def step(self, done, **metrics):
        self.cancelled = self.cancelled or (self.phases[-1] == self._stop and done >= self._after)


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bare") / "photographs"
    take(folder, cameras(COUNT), textures())
    return folder


@pytest.fixture
def stages(monkeypatch):
    return Stages(monkeypatch, SETTINGS, read=False)


@pytest.fixture(scope="module")
def undisturbed(photographs, tmp_path_factory):
    """A finished run, the dataset that its first stage received, and the phases that were reported."""
    with pytest.MonkeyPatch.context() as patch:
        stages, progress = Stages(patch, SETTINGS, read=False), Steps()
        run = pipeline.reconstruct(photographs, tmp_path_factory.mktemp("undisturbed") / "run", SETTINGS, progress=progress)
    return run, stages.data, progress.phases


def contents(run):
    """Bytes of the files that the capture leaves for the reader."""
    return {name: (run / CAPTURE / name).read_bytes() for name in CAPTURED}


def assert_times_add_up(state):
    """Every phase took some time, and the phase that reads the dataset not that of the capture."""
    assert all(phase["finished"] and phase["seconds"] >= 0 for phase in state["phases"].values())


def test_photographs_are_captured_into_the_run_and_read_from_there(undisturbed, photographs):
    run, data, phases = undisturbed
    state = read_run(run)
    assert state["status"] == "done" and list(state["phases"]) == ["capture", "read", "first stage", *ALL[1:]]
    assert_times_add_up(state)
    assert phases.index("find poses") < phases.index("undistort photographs") < phases.index("read images") < phases.index("first stage")
    assert data.format == "capture" and data.path == run / CAPTURE == posed_dataset(photographs, run)
    assert [view.name for view in (*data.train, *data.test)] == ["photo 1", "photo 2", "photo 3", "photo 0"]
    assert sorted(path.name for path in photographs.iterdir()) == [f"photo {i}.png" for i in range(COUNT)]  # nothing is written there


def test_textures_that_do_not_fit_are_refused_before_the_capture(photographs, stages, tmp_path, monkeypatch):
    monkeypatch.setattr(cpu_memory, "free_memory", lambda: cpu_memory.FreeMemory(4 << 30, "a test"))
    progress = Steps()
    with pytest.raises(InputError, match=r"textures of 16384 texels need about .* GiB to be baked, but only .* are available"):
        pipeline.reconstruct(photographs, tmp_path / "run", with_overrides(SETTINGS, ["surface.texture=16384"]), progress=progress)
    assert not progress.phases and not stages.ran and not (tmp_path / "run").exists()


def test_cameras_of_the_dataset_are_the_true_ones(undisturbed):
    """Distances between cameras have the true ratios."""
    _, data, _ = undisturbed
    found = {view.name: view.camera.centre for view in (*data.train, *data.test)}
    true = {f"photo {i}": pose[:3, 3] for i, pose in enumerate(cameras(COUNT))}
    pairs = [(f"photo {i}", f"photo {j}") for i in range(COUNT) for j in range(i)]
    ratios = np.array([np.linalg.norm(found[a] - found[b]) / np.linalg.norm(true[a] - true[b]) for a, b in pairs])
    assert np.ptp(ratios) < 0.03 * ratios.mean()


@pytest.mark.parametrize(("phase", "steps"), [("find features", 2), ("find poses", 1), ("undistort photographs", 2)])
def test_run_that_was_cancelled_in_its_capture_goes_on(undisturbed, photographs, stages, tmp_path, phase, steps):
    with pytest.raises(Cancelled):
        pipeline.reconstruct(photographs, tmp_path / "run", SETTINGS, progress=Steps(phase, steps))
    state = read_run(tmp_path / "run")
    assert state["status"] == "cancelled" and not state["phases"]["capture"]["finished"] and stages.ran == []
    kept = "left_out" in json.loads((tmp_path / "run" / CAPTURE / "poses.json").read_text("utf-8"))  # poses are complete
    assert not kept if phase == "find features" else kept or phase == "find poses"  # the last step of a few photographs may be done at once
    progress = Steps()
    pipeline.reconstruct(photographs, tmp_path / "run", SETTINGS, resume=True, progress=progress)
    assert stages.ran == ALL and ("find features" in progress.phases) == (not kept)
    assert contents(tmp_path / "run") == contents(undisturbed[0])
    assert read_run(tmp_path / "run")["status"] == "done"
    assert_times_add_up(read_run(tmp_path / "run"))


def test_run_that_was_cancelled_after_its_capture_keeps_it(photographs, stages, tmp_path):
    stages.stop, run = "train", tmp_path / "run"
    with pytest.raises(Cancelled):
        pipeline.reconstruct(photographs, run, SETTINGS)
    captured = {file: file.stat().st_mtime_ns for file in (run / CAPTURE).rglob("*") if file.is_file()}
    stages.stop, stages.ran[:], progress = "surface", [], Steps()
    with pytest.raises(Cancelled):
        pipeline.reconstruct(photographs, run, SETTINGS, resume=True, progress=progress)
    assert progress.phases[0] == "read images" and stages.ran == ["train again", *ALL[1:4]]
    stages.stop, stages.ran[:] = None, []
    pipeline.reconstruct(photographs, run, SETTINGS, resume=True)
    assert stages.ran == ALL[3:]
    assert {file: file.stat().st_mtime_ns for file in captured} == captured
    assert_times_add_up(read_run(run))


def test_time_budget_counts_the_capture_once(photographs, monkeypatch, tmp_path):
    now, capture = [1000.0], capturing.capture

    def slow(*args):
        now[0] += 60
        return capture(*args)

    settings = with_overrides(SETTINGS, ["time=300"])
    stages = Stages(monkeypatch, settings, read=False)
    monkeypatch.setattr(capturing, "capture", slow)
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    stages.stop = "train"
    with pytest.raises(Cancelled):
        pipeline.reconstruct(photographs, tmp_path / "run", settings)
    assert stages.deadline == pytest.approx(1300)  # 240 seconds from now
    stages.stop = None
    pipeline.reconstruct(photographs, tmp_path / "run", settings, resume=True)
    assert stages.deadline == pytest.approx(1300)  # as many are left


def test_photographs_that_can_not_be_captured_fail_the_run(photographs, tmp_path, stages):
    two = tmp_path / "two"
    two.mkdir()
    for name in ("photo 0.png", "photo 1.png"):
        (two / name).write_bytes((photographs / name).read_bytes())
    with pytest.raises(InputError, match="fewer than 3"):
        pipeline.reconstruct(two, tmp_path / "run", SETTINGS)
    state = read_run(tmp_path / "run")
    assert state["status"] == "failed" and "fewer than 3" in state["error"] and stages.ran == []


def test_another_sphere_resumes_a_run_with_the_poses_it_has(undisturbed, photographs, monkeypatch, tmp_path):
    """Here it is the bound alone, as the photographs are used whole."""
    run = shutil.copytree(undisturbed[0], tmp_path / "run")
    Stages(monkeypatch, SETTINGS, read=False)
    poses = (run / CAPTURE / "poses.json").read_bytes()
    cameras_before = (run / CAPTURE / "cameras.json").read_bytes()
    finished = (run / "run.json").read_bytes()
    far = with_overrides(SETTINGS, ["capture.centre=0,0,900", "capture.radius=0.1"])
    with pytest.raises(InputError, match="is shown by 0 of 4 photographs"):
        pipeline.reconstruct(photographs, run, far, resume=True)
    assert (run / "run.json").read_bytes() == finished and (run / "mesh.ply").exists()
    moved = with_overrides(SETTINGS, ["capture.centre=0.1,0,0", "capture.radius=0.4"])
    stages, progress = Stages(monkeypatch, moved, read=False), Steps()
    pipeline.reconstruct(photographs, run, moved, resume=True, progress=progress)
    assert stages.ran == ALL and "find features" not in progress.phases
    assert (run / CAPTURE / "poses.json").read_bytes() == poses and (run / CAPTURE / "cameras.json").read_bytes() == cameras_before
    assert stages.data.bound.centre == (0.1, 0.0, 0.0) and stages.data.bound.radius == 0.4
    assert read_run(run)["settings"]["capture"]["radius"] == 0.4


def test_a_sphere_is_of_photographs_without_cameras(tmp_path, stages):
    settings = with_overrides(SETTINGS, ["capture.centre=0.1,0,0", "capture.radius=0.4"])
    with pytest.raises(InputError, match="are for photographs without cameras, which this dataset has; cut a capture out again"):
        pipeline.reconstruct(pipeline.DEMO_DATA, tmp_path / "run", settings)
    assert not (tmp_path / "run").exists()
