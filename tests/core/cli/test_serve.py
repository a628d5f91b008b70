# SPDX-License-Identifier: GPL-3.0-or-later
"""Request server: answers through files, only to the newest request, reports bad ones, and ends when it should."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import warm_engine
from irgspp.core.machine.blender_process import LAUNCHER
from irgspp.core.relight.backends import open_relighter
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.reconstruction import Reconstruction
from relight_run import write_relightable

EYE = Camera(128, 96, 140.0, 140.0, 64.0, 48.0, look_at((3.0, 1.0, 1.5)))
PATIENCE = 300.0  # seconds, on a machine that has other things to do
WHOLE = [1, 0, 0, 0, 1, 0, 0, 0, 1]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served") / "ball"
    write_relightable(folder)
    return folder


class Worker:
    """Client of `irgspp serve`."""

    def __init__(self, run: Path, session: Path, python: str = sys.executable) -> None:
        self.session, self.number = session, 0
        session.mkdir()
        words = [python, str(LAUNCHER), "__main__", "serve", str(run), "--session", str(session)]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def ask(self, channel="a", camera=EYE, **values):
        self.number += 1
        lens = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
        request = {"number": self.number, "camera": {**lens, "to_world": camera.to_world.tolist()}, "samples": 16, **values}
        self.put(channel, json.dumps(request))
        return self.number

    def put(self, channel, text):
        partial = self.session / "partial"
        partial.write_text(text)
        os.replace(partial, self.session / f"request-{channel}.json")

    def answer(self, number, channel="a", done=True, seconds=PATIENCE):
        """The answer to a request, all of it or its first image."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            file = self.session / f"answer-{channel}.json"
            about = json.loads(file.read_text()) if file.exists() else {"number": None}
            if about["number"] == number and (about["done"] or (not done and about["picture"])):
                return about
            assert self.process.poll() is None, self.process.stderr and self.process.stderr.read()
            time.sleep(0.005)
        raise AssertionError(f"no answer to {number}")

    def image(self, **values):
        return np.load(self.session / self.answer(self.ask(**values))["picture"])

    def end(self, seconds=PATIENCE):
        return self.process.wait(seconds)


@pytest.fixture(scope="module")
def worker(run, tmp_path_factory):
    """A server for all tests, which ends by the file `stop`."""
    worker = Worker(run, tmp_path_factory.mktemp("session") / "a")
    yield worker
    (worker.session / "stop").touch()
    try:
        assert worker.end() == 0
    finally:
        worker.process.kill()
        worker.process.wait()


def reference(run, light, samples=16, backend="mesh", camera=EYE):
    relighter = open_relighter(run, Reconstruction.load(run), backend, RelightSettings(samples=samples))
    return relighter.relit(relighter.surface(camera), prepare_light(light)).numpy()


def light_file(worker, name="light.npy", factor=1.0):
    light = (factor * np.random.default_rng(1).random((256, 512, 3))).astype(np.float32)
    np.save(worker.session / name, light)
    return light, {"map": name, "turn": WHOLE, "strength": 1.0}


@pytest.mark.parametrize("backend", ["mesh", "gaussian"])
def test_images_are_those_of_the_relighter(worker, run, backend):
    light, named = light_file(worker)
    assert np.array_equal(worker.image(light=named, backend=backend), reference(run, light, backend=backend))
    recovered = Reconstruction.load(run).environment_map()
    assert np.array_equal(worker.image(backend=backend), reference(run, recovered, backend=backend))


def test_light_is_turned_and_scaled(worker, run):
    light, named = light_file(worker)
    quarter = [0, -1, 0, 1, 0, 0, 0, 0, 1]  # +X sees the texel of +Y, which is a quarter of the image further left
    turned = worker.image(light={**named, "turn": quarter, "strength": 2.0})
    expected = reference(run, 2 * np.roll(light, light.shape[1] // 4, 1))
    assert np.abs(turned - expected).mean() < 0.01 * expected.mean()


def test_backdrop_is_the_light_behind(worker):
    light, named = light_file(worker)
    plain, backed = worker.image(light=named), worker.image(light=named, backdrop=True)
    assert np.allclose(backed[..., 3], 1) and plain[0, 0, 3] == 0
    assert backed[0, 0, :3].min() >= 0 and backed[0, 0, :3].max() <= light.max() and backed[0, 0, :3].any()
    inside = plain[..., 3] == 1
    assert inside.any() and np.allclose(plain[inside], backed[inside])


def test_first_images_come_before_the_last(worker):
    number = worker.ask(samples=512, albedo_scale=[0.9, 1, 1])
    first = worker.answer(number, done=False)
    small = np.load(worker.session / first["picture"]) if not first["done"] else None
    last = worker.answer(number)
    assert last["pass"] == last["passes"] == 3 and last["share"] == 1.0
    assert small is None or small.shape[1] <= 128
    assert np.load(worker.session / last["picture"]).shape == (96, 128, 4)
    assert worker.answer(worker.ask(samples=512, progressive=False))["passes"] == 1


def test_only_the_newest_request_is_answered_and_cancel_stops(worker):
    big = Camera(1024, 768, 1120.0, 1120.0, 512.0, 384.0, EYE.to_world)
    slow = worker.ask(camera=big, samples=4096, backend="gaussian")
    worker.answer(slow, done=False)
    quick = worker.ask(samples=4)
    assert worker.answer(quick, seconds=60.0)["error"] is None  # the slow one would take minutes
    slow = worker.ask(camera=big, samples=4096, backend="gaussian")
    worker.answer(slow, done=False)
    worker.put("a", json.dumps({"number": slow + 1, "cancel": True}))
    worker.number += 1
    assert worker.answer(worker.ask(channel="b", samples=4), "b", seconds=60.0)["done"]
    assert not json.loads((worker.session / "answer-a.json").read_text())["done"]


def test_channels_share_the_worker(worker):
    big = Camera(256, 192, 280.0, 280.0, 128.0, 96.0, EYE.to_world)
    slow = worker.ask(channel="slow", camera=big, samples=512)
    quick = worker.ask(channel="quick", samples=4)
    assert worker.answer(quick, "quick")["error"] is None
    assert worker.answer(slow, "slow")["error"] is None


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"samples": "many"}, "not a valid number of samples"),
        ({"samples": None}, "must be a number"),
        ({"backend": "cloud"}, "backend cloud"),
        ({"albedo_scale": [1, -1, 1]}, "albedo scale"),
        ({"light": {"map": "none.npy", "turn": WHOLE, "strength": 1}}, "can't be read"),
        ({"light": {"map": "none.npy", "turn": [2] * 9, "strength": 1}}, "not a rotation"),
        ({"light": "none.npy"}, "can't be understood"),
        ({"camera": {}}, "can't be understood"),
        ({"camera": {"width": 0, "height": 9, "fx": 1, "fy": 1, "cx": 0, "cy": 0, "to_world": np.eye(4).tolist()}}, "image of 0 x 9"),
    ],
)
def test_bad_requests_are_reported(worker, values, words):
    camera = values.pop("camera", None)
    number = worker.ask(**values)
    if camera is not None:
        number = worker.number = number + 1
        worker.put("a", json.dumps({"number": number, "camera": camera}))
    assert words in worker.answer(number)["error"]
    assert worker.answer(worker.ask(samples=4))["error"] is None


def test_files_that_are_no_request_are_reported(worker):
    worker.put("c", "{")
    assert "is not valid JSON" in worker.answer(-1, "c")["error"]
    worker.put("c", "[1]")
    assert worker.answer(worker.ask(channel="c", samples=4), "c")["error"] is None


def test_few_images_are_kept(worker):
    for _ in range(4):
        worker.answer(worker.ask(samples=16))
    end = time.monotonic() + PATIENCE
    while len(list(worker.session.glob("a-*.npy"))) > 2:  # it answers first and tidies up then
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.mark.parametrize("how", ["stdin", "folder"])  # the third is `stop`, at the end of the fixture `worker`
def test_it_ends_when_asked(run, tmp_path, how):
    worker = Worker(run, tmp_path / "session", warm_engine.engine(sys.executable))
    assert worker.process.stdin is not None
    worker.answer(worker.ask(samples=4))
    if how == "stdin":
        worker.process.stdin.close()
    else:
        shutil.rmtree(worker.session)
    assert worker.end() == 0


def test_it_ends_with_its_parent(run, tmp_path):
    """Even where somebody else holds its stdin open."""
    session = tmp_path / "session"
    session.mkdir()
    words = [sys.executable, "-m", "irgspp", "serve", str(run), "--session", str(session)]
    read, write = os.pipe()
    code = f"import subprocess, time; print(subprocess.Popen({words!r}, stdin={read}).pid, flush=True); time.sleep(600)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, pass_fds=[read]) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        end = time.monotonic() + PATIENCE
        while not (session / "ready.json").exists():
            assert time.monotonic() < end
            time.sleep(0.02)
        parent.kill()
    while _runs(pid):
        assert time.monotonic() < end
        time.sleep(0.02)
    os.close(read)
    os.close(write)


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except OSError:
        return False


def test_runs_that_can_not_be_served(tmp_path):
    words = [warm_engine.engine(sys.executable), str(LAUNCHER), "__main__", "serve", str(tmp_path / "none")]
    for session, text in ((tmp_path, "no such file"), (tmp_path / "gone", "is not a folder")):
        done = subprocess.run([*words, "--session", str(session)], capture_output=True, text=True, stdin=subprocess.PIPE, check=False)
        assert done.returncode == 2 and text in done.stderr
