# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole public interface in seconds: the demo dataset through a job of tiny settings, and jobs that are stopped and resumed."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import trimesh
from irgspp.core import pipeline
from irgspp.core.cli.main import main
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import Cancelled
from irgspp.core.io.exr import read_exr, read_exr_rgb
from irgspp.core.pipeline import DEMO_DATA, reconstruct
from irgspp.core.progress.protocol import Silent
from irgspp.core.run_folder import read_run
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from small_scenes import small_scene

TINY = (
    "materials=low-gloss",  # the trial fits take longer than the rest; the demo below runs them
    "first.iterations=160",
    "first.gaussians=3000",
    "second.points=500",
    "second.rows=8",
    "second.iterations=30",
    "second.pool=10000",
    "second.radiance_iterations=40",
    "second.normal_iterations=20",
    "surface.voxels=48",
    "surface.triangles=3000",
    "surface.texture=128",
)
FEW = ("first.iterations=4", "first.stereo=on", "second.points=200", "second.iterations=4", "second.pool=1000", "second.pixels=32")
FEW += ("second.radiance_iterations=4", "second.normal_iterations=4")
STOP, KEEP = 111, 100  # density control, in step 80, lies before them
# Measured: 26.9, 26.8, 22.6, 25.5, 15.4 dB; 0.165, 0.029; 12.2 degrees, 0.039, 0.013 and 0.0044 in scene units.
LEAST = {"radiance_psnr": 25.5, "nvs_psnr": 25, "albedo_psnr": 20.5, "relight_psnr": 23.5, "environment_psnr": 13.5}
MOST = {"roughness_mae": 0.2, "metallic_mae": 0.06, "normal_mae": 14, "depth_mae": 0.05, "mesh_chamfer": 0.018, "mesh_stray": 0.02}
TEST_VIEWS = [f"r_{i:03d}" for i in range(6)]


@pytest.fixture(scope="module")
def settings():
    return with_overrides(preset("draft"), TINY)


@pytest.fixture(scope="module")
def run(settings, tmp_path_factory):
    """An uninterrupted job."""
    return reconstruct(DEMO_DATA, tmp_path_factory.mktemp("undisturbed") / "run", settings)


@pytest.fixture(scope="module")
def quick(settings):
    """Return a context in which jobs of this process leave out the Blender scene, which `run` has, and do not read the dataset again."""
    data = load_dataset(DEMO_DATA, settings.data)

    @contextmanager
    def patched():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pipeline, "write_blend", lambda *_: None)
            patch.setattr(pipeline, "load_dataset", lambda path, *_: {DEMO_DATA: data}[path])
            yield

    return patched


class StopAt(Silent):
    """Progress that cancels the job once the named phase has finished so many steps."""

    def __init__(self, phase, steps):
        self.stop, self.now = (phase, steps), ""

    def phase(self, name, steps):
        self.now = name

    def step(self, done, **metrics):
        if self.now == self.stop[0] and done >= self.stop[1]:
            self.cancelled = True


def stop_and_resume(folder, settings, places, begun):
    """Cancel a job at each of the places (phase, steps) in turn."""
    for resume, place in enumerate(places, begun):
        with pytest.raises(Cancelled):
            reconstruct(DEMO_DATA, folder, settings, resume=bool(resume), progress=StopAt(*place))
        assert read_run(folder)["status"] == "cancelled"
        assert (folder / "checkpoint" / "first_stage.pt").exists()
        assert (folder / "gaussians.ply").exists() == (place[0] in ("bake", "contact sheet"))


@pytest.fixture(scope="module")
def traced(settings, quick, tmp_path_factory):
    """A job that was cancelled in the first stage, and twice on its way to the second."""
    folder = tmp_path_factory.mktemp("stopped") / "run"
    with quick():
        stop_and_resume(folder, settings, (("first stage", STOP), ("fuse", 5), ("trace", 1)), 0)
    return folder


def test_job_leaves_a_complete_run_folder(run):
    state = read_run(run)
    assert state["status"] == "done"
    assert all(phase["finished"] for phase in state["phases"].values())
    expected = {"run.json", "events.jsonl", "log.txt", "gaussians.ply", "environment.exr", "mesh.ply", "textures", "asset.glb"}
    expected |= {"cameras.json", "contact_sheet.png"}
    assert expected <= {path.name for path in run.iterdir()}
    assert (run / "scene.blend").exists() or state["skipped"][0]["what"] == "scene.blend"
    assert not [path for path in run.rglob("*") if ".part" in path.name]
    steps = [e for line in (run / "events.jsonl").read_text().splitlines() if "loss" in (e := json.loads(line))]
    assert steps[-1]["step"] == 160
    assert steps[-1]["loss"] < 0.6 * steps[0]["loss"]


def test_asset_opens_elsewhere(run):
    scene = trimesh.load(run / "asset.glb")
    (body,) = scene.geometry.values()
    assert body.visual.material.baseColorTexture.size == (128, 128)
    assert np.ptp(body.vertices, axis=0).max() > 0.5


def test_views_from_the_command_line(run, tmp_path, capsys):
    out = tmp_path / "views"
    assert main(["render", str(run), "--views", f"{DEMO_DATA}:test", "-o", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out)
    assert sorted(path.name for path in out.iterdir()) == TEST_VIEWS
    view = out / TEST_VIEWS[0]
    names = {"rgba.exr", "rgba.png", "albedo.exr", "normal.exr", "depth.exr", "material.exr", "radiance.exr"}
    assert {path.name for path in view.iterdir()} == names
    rgba, depth = read_exr(view / "rgba.exr"), read_exr(view / "depth.exr")["Z"]
    truth = read_exr(DEMO_DATA / "test" / TEST_VIEWS[0] / "depth.exr")["Z"]
    inside = (truth > 0) & (rgba["A"] > 0.9)
    assert inside.sum() > 0.8 * (truth > 0).sum()
    assert np.median(np.abs(depth - truth)[inside]) < 0.1

    command = ["render", str(run), "--views", str(DEMO_DATA), "-o", str(out), "--layers", "rgba"]
    assert main([*command, "--environment", str(DEMO_DATA / "envs" / "sunset.exr"), "--strength", "2"]) == 0
    assert (view / "rgba_sunset.exr").exists()
    assert not np.allclose(read_exr(view / "rgba_sunset.exr")["R"], rgba["R"], atol=0.01)


def test_evaluation_from_the_command_line(run, tmp_path, capsys):
    """Seconds of training on 64 x 64 pixels give a sound result: every metric is well above that of an untrained scene."""
    report = tmp_path / "report"
    assert main(["evaluate", str(run), str(DEMO_DATA), "-o", str(report)]) == 0
    output = capsys.readouterr().out
    metrics = json.loads((report / "report.json").read_text())["figures"]
    assert all(name in output for name in metrics)
    for name, least in LEAST.items():
        assert metrics[name] > least, name
    for name, most in MOST.items():
        assert metrics[name] < most, name
    assert read_run(run)["training"]["test_radiance_psnr"] == pytest.approx(metrics["radiance_psnr"], abs=0.01)
    light = read_exr_rgb(run / "environment.exr")
    assert np.isfinite(light).all() and light.min() >= 0


def test_exports_from_the_command_line(run, tmp_path):
    for name, source in (("o.glb", "asset.glb"), ("o.ply", "gaussians.ply"), ("o.exr", "environment.exr")):
        assert main(["export", str(run), "-o", str(tmp_path / name)]) == 0
        assert (tmp_path / name).read_bytes() == (run / source).read_bytes()
    if (run / "scene.blend").exists():
        assert main(["export", str(run), "-o", str(tmp_path / "o.blend"), "--material", "attributes"]) == 0
        assert (tmp_path / "o.blend").stat().st_size > 10_000


def test_inspection_from_the_command_line(capsys):
    assert main(["inspect", str(DEMO_DATA)]) == 0
    assert "40 training, 6 test" in capsys.readouterr().out


def test_demo_from_the_command_line(tmp_path, capsys):
    """It decides the material class by trial fits."""
    words = [
        *TINY,
        "materials=auto",
        "first.stereo=off",
        "second.normal_iterations=4",
        "first.iterations=8",
        "first.trial_iterations=4",
        "first.trial_gaussians=500",
    ]
    assert main(["demo", "-o", str(tmp_path / "demo"), *(part for word in words for part in ("--set", word))]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "demo" / "contact_sheet.png")
    state = read_run(tmp_path / "demo")
    assert (state["status"], state["settings"]["preset"], state["settings"]["materials"]) == ("done", "balanced", "auto")
    assert re.search(r"materials: .*\d dB", (tmp_path / "demo" / "log.txt").read_text())


def test_cancelled_job_resumes_to_the_same_result(run, traced, settings, tmp_path, quick):
    stopped = shutil.copytree(traced, tmp_path / "run")
    places = (("second stage", 11), ("paint", 1), ("refine", 7), ("radiance", 9), ("bake", 3), ("contact sheet", 2))
    with quick():
        stop_and_resume(stopped, settings, places, 1)
        reconstruct(DEMO_DATA, stopped, settings, resume=True)
    assert_same(stopped, run)


def test_job_whose_second_stage_is_finished_early_completes(run, traced, settings, tmp_path, quick):
    class FinishEarly(Silent):
        """Progress that finishes the second stage early, after five steps."""

        def phase(self, name, steps):
            self.finish_early = False
            self.now, self.last = name, 0

        def step(self, done, **metrics):
            if self.now == "second stage":
                self.last, self.finish_early = done, done >= 5
                assert done <= 5

    shutil.copytree(traced, tmp_path / "run")
    with quick():
        reconstruct(DEMO_DATA, tmp_path / "run", settings, resume=True, progress=FinishEarly())
    state = read_run(tmp_path / "run")
    assert state["status"] == "done" and all(phase["finished"] for phase in state["phases"].values())
    assert (tmp_path / "run" / "environment.exr").read_bytes() != (run / "environment.exr").read_bytes()


KILLED = f"""
import os, signal, sys
from irgspp.core.cli.main import main
from irgspp.core.progress.recorder import ProgressRecorder
from irgspp.core.stages.first import trainer

def step(self, done, **metrics):  # of the first stage: a checkpoint after step {KEEP}, the end in step {STOP}
    if "loss" not in metrics:  # trial fits and other phases
        return
    trainer.CHECKPOINT_SECONDS = -1.0 if done == {KEEP} else 1e9
    if done == {STOP}:
        os.kill(os.getpid(), signal.SIGKILL)

ProgressRecorder.step = step
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_killed_job_resumes_to_the_same_result(run, tmp_path):
    killed = tmp_path / "run"
    command = ["reconstruct", str(DEMO_DATA), "-o", str(killed), "--preset", "draft"]
    command += [word for text in TINY for word in ("--set", text)]
    ended = subprocess.run([sys.executable, "-P", "-c", KILLED, *command], stderr=subprocess.DEVNULL)
    assert ended.returncode == -signal.SIGKILL
    assert read_run(killed)["status"] == "running"
    assert (killed / "checkpoint" / "first_stage.pt").exists()
    assert main(["reconstruct", str(DEMO_DATA), "-o", str(killed), "--resume"]) == 0
    steps = [e["step"] for line in (killed / "events.jsonl").read_text().splitlines() if "loss" in (e := json.loads(line))]
    assert steps[0] == KEEP + 1
    assert_same(killed, run)


def publish(compiled):
    """Copy compiled kernels that the cache of this process lacks there: each process of the tests would else compile them again."""
    (folder,) = compiled.glob("kernels-*")
    for path in sorted(folder.rglob("*.nb[ci]"), key=lambda path: path.suffix):  # .nbc, the code, before .nbi, its index
        target = Path(os.environ["NUMBA_CACHE_DIR"]) / path.relative_to(folder)
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            part = shutil.copyfile(path, target.with_suffix(f".part{os.getpid()}"))
            os.replace(part, target)


@pytest.mark.long(seconds=120)
def test_first_run_on_a_machine_is_like_the_later_ones(tmp_path):
    """Kernels are compiled in the first, read from the cache in the second; on stereo's points, with half as many views as the demo's."""
    environment = {**os.environ, "IRGSPP_CACHE": str(tmp_path / "cache")}
    environment.pop("NUMBA_CACHE_DIR", None)  # this process has set it
    for name in ("first", "second"):
        command = [sys.executable, "-P", "-m", "irgspp", "reconstruct", str(small_scene("bowl")), "-o", str(tmp_path / name)]
        command += ["--preset", "draft"]
        command += [word for text in (*TINY, *FEW) for word in ("--set", text)]
        subprocess.run(command, env=environment, stderr=subprocess.DEVNULL, check=True)
        publish(tmp_path / "cache")
    assert list((tmp_path / "cache").rglob("*.nbc"))
    assert_same(tmp_path / "second", tmp_path / "first")


def assert_same(run, other):
    assert read_run(run)["status"] == "done"
    for name in ("gaussians.ply", "environment.exr", "mesh.ply", "textures/albedo.png", "asset.glb"):
        assert (run / name).read_bytes() == (other / name).read_bytes(), name
