# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs for tests: settings for reconstructions of seconds, a script that replaces the engine, and a job folder for each test."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import blender_side
import pytest
from shared_folder import shared_folder
from small_scenes import small_scene

PATIENCE = 300.0  # seconds, enough on a busy machine
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and links of POSIX")
DATASET = small_scene("bowl")  # it has half as many views as the demo's
TINY = {
    "data.resolution": 32,
    "first.iterations": 20,
    "first.gaussians": 1000,
    "first.stereo": "off",
    "second.points": 100,
    "second.rows": 4,
    "second.views": 4,
    "second.iterations": 5,
    "second.pixels": 32,
    "second.samples": 8,
    "second.pool": 1000,
    "second.radiance_iterations": 5,
    "second.normal_iterations": 4,
    "surface.voxels": 24,
    "surface.triangles": 500,
    "surface.texture": 64,
    "surface.albedo_detail": "off",
}
ENDLESS = {"first.iterations": 1_000_000}  # runs until it is stopped
COUNTER = blender_side.ROOT / "scripts" / "faulting" / "counter.py"  # a stand-in for the engine


def settings(**more: object) -> list[str]:
    """Return arguments `--set name=value`; in keyword names two underscores stand for the dot."""
    chosen = TINY | {key.replace("__", "."): value for key, value in more.items()}
    return [word for key, value in chosen.items() for word in ("--set", f"{key}={value}")]


def reconstruction(run: Path, **more: object) -> list[str]:
    """Return arguments of a `reconstruct` that takes seconds."""
    return ["reconstruct", str(DATASET), "-o", str(run), "--preset", "draft", "--materials", "low-gloss", *settings(**more)]


def finished_run(factory: pytest.TempPathFactory) -> Path:
    """Return the place of a finished run of `reconstruction` for all processes of the tests; the first that has one leaves it there."""
    return shared_folder(factory) / "finished_reconstruction"


def leave_finished(run: Path, factory: pytest.TempPathFactory) -> None:
    """Copy a finished run of `reconstruction` to the place where other tests look for one."""
    if finished_run(factory).exists():
        return
    part = shutil.copytree(run, factory.mktemp("copied") / "run")
    with contextlib.suppress(OSError):  # another process was faster
        os.rename(part, finished_run(factory))


def until(condition: Callable[[], object], seconds: float = PATIENCE) -> None:
    """Poll the jobs, as Blender's timer does, until a condition is true."""
    from irgspp.irgspp_addon.jobs import queue

    end = time.monotonic() + seconds
    while not condition():
        queue.poll()
        assert time.monotonic() < end, [(job.title, job.state, job.error, job.log_tail()) for job in queue.all_jobs()]
        time.sleep(0.05)


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Redirect the extension's user files to an empty folder of the test, and kill its jobs at the end."""
    from irgspp.irgspp_addon import user_folder
    from irgspp.irgspp_addon.engine import managed
    from irgspp.irgspp_addon.engine import process as engine
    from irgspp.irgspp_addon.jobs import process as job_process
    from irgspp.irgspp_addon.jobs import queue, session

    folder = tmp_path / "user"

    def place(name: str = "") -> Path:
        (folder / name).mkdir(parents=True, exist_ok=True)
        return folder / name

    for module in (user_folder, queue, session, engine, managed):
        monkeypatch.setattr(module, "user_folder", place)
    queue.clear()
    session.end_session()
    engine._known.clear()
    yield folder
    for job in queue.all_jobs():
        job_process.kill(job)
    queue.clear()
    session.end_session()
    engine._known.clear()


@pytest.fixture
def counter() -> Callable[..., object]:
    """Return a function that starts a job that counts to a number; it also takes options of `queue.start`."""
    from irgspp.irgspp_addon.jobs import queue

    def start(steps: int = 1000, kind: str = "render", folder: Path | None = None, **options):
        return queue.start(kind, f"count to {steps}", folder, [str(steps)], program=str(COUNTER), **options)

    return start
