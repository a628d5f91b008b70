# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs for tests: settings so small that all takes seconds, a script that stands for the engine, a registry of the test's own."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import blender_side
import pytest

PATIENCE = 300.0  # seconds, on a machine that has other things to do
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals and links of POSIX")
DATASET = blender_side.ROOT / "core" / "demo_data"
TINY = {
    "data.resolution": 32,
    "first.iterations": 20,
    "first.gaussians": 1000,
    "second.points": 300,
    "second.rows": 8,
    "second.iterations": 5,
    "second.radiance_iterations": 5,
    "surface.voxels": 24,
    "surface.triangles": 500,
    "surface.texture": 64,
}
ENDLESS = {"first.iterations": 1_000_000}  # until somebody stops it
COUNTER = blender_side.ROOT / "scripts" / "faulting" / "counter.py"  # a stand-in for the engine


def settings(**more: object) -> list[str]:
    """Words for --set; names with two underscores for the dot."""
    chosen = TINY | {key.replace("__", "."): value for key, value in more.items()}
    return [word for key, value in chosen.items() for word in ("--set", f"{key}={value}")]


def reconstruction(run: Path, **more: object) -> list[str]:
    """Words of a `reconstruct` of the embedded dataset that takes seconds."""
    return ["reconstruct", str(DATASET), "-o", str(run), "--preset", "draft", "--materials", "low-gloss", *settings(**more)]


def until(what: Callable[[], object], seconds: float = PATIENCE) -> None:
    """Poll the jobs until something is true, as Blender's timer does."""
    from irgspp.irgspp_addon.jobs import queue as jobs

    end = time.monotonic() + seconds
    while not what():
        jobs.poll()
        assert time.monotonic() < end, [(job.title, job.state, job.error, job.log_tail()) for job in jobs.all_jobs()]
        time.sleep(0.05)


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty registry of jobs in a folder of the test, whose processes are ended with it."""
    from irgspp.irgspp_addon import user_folder
    from irgspp.irgspp_addon.engine import managed as managed_engine
    from irgspp.irgspp_addon.engine import process as engine
    from irgspp.irgspp_addon.jobs import process as job_process
    from irgspp.irgspp_addon.jobs import queue as jobs
    from irgspp.irgspp_addon.jobs import session

    folder = tmp_path / "user"

    def place(name: str = "") -> Path:
        (folder / name).mkdir(parents=True, exist_ok=True)
        return folder / name

    for module in (user_folder, jobs, session, engine, managed_engine):
        monkeypatch.setattr(module, "user_folder", place)
    jobs.clear()
    session.end_session()
    engine._known.clear()
    yield folder
    for job in jobs.all_jobs():
        job_process.kill(job)
    jobs.clear()
    session.end_session()
    engine._known.clear()


@pytest.fixture
def counter() -> Callable[..., object]:
    """Start a job that counts: how far, and what `jobs.start` takes besides its words."""
    from irgspp.irgspp_addon.jobs import queue as jobs

    def start(steps: int = 1000, kind: str = "render", folder: Path | None = None, **options):
        return jobs.start(kind, f"count to {steps}", folder, [str(steps)], program=str(COUNTER), **options)

    return start
