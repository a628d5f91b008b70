# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs that are cancelled, finished early or killed, and the first job on a machine: resumed or repeated, the result is the same."""

import json
import os
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from irgspp.core import pipeline
from irgspp.core.cli.main import main
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import Cancelled
from irgspp.core.pipeline import reconstruct
from irgspp.core.progress.protocol import Silent
from irgspp.core.run_folder import read_run
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from small_scenes import small_scene
from unwrapped_here import unwrap_here

SMALL = small_scene("bowl")  # it has half as many views as the demo's
SHORT = (
    "materials=low-gloss",
    "first.stereo=off",
    "first.iterations=80",
    "first.gaussians=2000",
    "second.points=100",
    "second.rows=4",
    "second.views=4",
    "second.iterations=14",
    "second.pool=3000",
    "second.radiance_iterations=12",
    "second.normal_iterations=10",
    "surface.voxels=40",
    "surface.triangles=1000",
    "surface.texture=64",
)
FEW = ("first.iterations=4", "first.stereo=on", "second.points=200", "second.views=4", "second.iterations=4", "second.pixels=32")
FEW += ("second.pool=1000", "second.radiance_iterations=4", "second.normal_iterations=4", "data.resolution=32", "first.gaussians=1000")
FEW += ("surface.voxels=24", "surface.triangles=500")
STOP, KEEP = 66, 60  # density control, in step 48, lies before them


@pytest.fixture(scope="module")
def settings():
    return with_overrides(preset("draft"), SHORT)


@pytest.fixture(scope="module")
def quick(settings):
    """Return a context in which jobs of this process leave out the Blender scene, unwrap here, and do not read the dataset again."""
    data = load_dataset(SMALL, settings.data)

    @contextmanager
    def patched():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pipeline, "write_blend", lambda *_: None)
            patch.setattr(pipeline, "load_dataset", lambda path, *_: {SMALL: data}[path])
            unwrap_here(patch)
            yield

    return patched


@pytest.fixture(scope="module")
def undisturbed(settings, quick, tmp_path_factory):
    """The job that the others interrupt."""
    with quick():
        return reconstruct(SMALL, tmp_path_factory.mktemp("undisturbed") / "run", settings)


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
            reconstruct(SMALL, folder, settings, resume=bool(resume), progress=StopAt(*place))
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


def test_cancelled_job_resumes_to_the_same_result(undisturbed, traced, settings, tmp_path, quick):
    stopped = shutil.copytree(traced, tmp_path / "run")
    places = (("second stage", 11), ("paint", 1), ("refine", 7), ("radiance", 9), ("bake", 3), ("contact sheet", 2))
    with quick():
        stop_and_resume(stopped, settings, places, 1)
        reconstruct(SMALL, stopped, settings, resume=True)
    assert_same(stopped, undisturbed)


def test_job_whose_second_stage_is_finished_early_completes(undisturbed, traced, settings, tmp_path, quick):
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
        reconstruct(SMALL, tmp_path / "run", settings, resume=True, progress=FinishEarly())
    state = read_run(tmp_path / "run")
    assert state["status"] == "done" and all(phase["finished"] for phase in state["phases"].values())
    assert (tmp_path / "run" / "environment.exr").read_bytes() != (undisturbed / "environment.exr").read_bytes()


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
def test_killed_job_resumes_to_the_same_result(undisturbed, tmp_path, quick):
    killed = tmp_path / "run"
    command = ["reconstruct", str(SMALL), "-o", str(killed), "--preset", "draft"]
    command += [word for text in SHORT for word in ("--set", text)]
    ended = subprocess.run([sys.executable, "-P", "-c", KILLED, *command], stderr=subprocess.DEVNULL)
    assert ended.returncode == -signal.SIGKILL
    assert read_run(killed)["status"] == "running"
    assert (killed / "checkpoint" / "first_stage.pt").exists()
    with quick():
        assert main(["reconstruct", str(SMALL), "-o", str(killed), "--resume"]) == 0
    steps = [e["step"] for line in (killed / "events.jsonl").read_text().splitlines() if "loss" in (e := json.loads(line))]
    assert steps[0] == KEEP + 1
    assert_same(killed, undisturbed)


def publish(compiled):
    """Copy compiled kernels that the cache of this process lacks there: each process of the tests would else compile them again."""
    (folder,) = compiled.glob("kernels-*")
    for path in sorted(folder.rglob("*.nb[ci]"), key=lambda path: path.suffix):  # .nbc, the code, before .nbi, its index
        target = Path(os.environ["NUMBA_CACHE_DIR"]) / path.relative_to(folder)
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            part = shutil.copyfile(path, target.with_suffix(f".part{os.getpid()}"))
            os.replace(part, target)


@pytest.mark.long(seconds=25)
def test_first_run_on_a_machine_is_like_the_later_ones(tmp_path):
    """An eighth of the kernels are compiled in the first, all are read from the cache in the second; on stereo's points.

    All kernels are compiled in the faults' case "read-only install folder".
    """
    own = Path(os.environ["NUMBA_CACHE_DIR"])
    unfinished = shutil.ignore_patterns("*.tmp.*", "*.part*")  # of another process, which renames them meanwhile
    cache = shutil.copytree(own, tmp_path / "cache" / own.name, ignore=unfinished)
    for index in sorted(cache.rglob("*.nbi"))[::8]:
        for code in (index, *index.parent.glob(f"{index.stem}.*.nbc")):
            code.unlink()
    kept = len(list(cache.rglob("*.nbi")))
    environment = {**os.environ, "IRGSPP_CACHE": str(tmp_path / "cache")}
    environment.pop("NUMBA_CACHE_DIR", None)  # this process has set it
    for name in ("first", "second"):
        command = [sys.executable, "-P", "-m", "irgspp", "reconstruct", str(SMALL), "-o", str(tmp_path / name)]
        command += ["--preset", "draft"]
        command += [word for text in (*SHORT, *FEW) for word in ("--set", text)]
        subprocess.run(command, env=environment, stderr=subprocess.DEVNULL, check=True)
        publish(tmp_path / "cache")
    assert len(list(cache.rglob("*.nbi"))) > kept
    assert_same(tmp_path / "second", tmp_path / "first")


def assert_same(run, other):
    assert read_run(run)["status"] == "done"
    for name in ("gaussians.ply", "environment.exr", "mesh.ply", "textures/albedo.png", "asset.glb"):
        assert (run / name).read_bytes() == (other / name).read_bytes(), name
