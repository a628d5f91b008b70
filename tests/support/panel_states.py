# SPDX-License-Identifier: GPL-3.0-or-later
"""States that panels are drawn in: a fresh scene with the extension, a job in the list, a run folder."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import blender_side  # noqa: F401  (before bpy)
import bpy
import irgspp
import pytest
from irgspp.irgspp_addon.jobs import queue as jobs
from irgspp.irgspp_addon.jobs.job import Job
from irgspp.irgspp_addon.properties import show_jobs
from irgspp.panels import run_state


@pytest.fixture
def settings() -> Iterator[bpy.types.PropertyGroup]:
    """The panel's settings in a fresh scene, with the extension registered."""
    bpy.ops.wm.read_homefile(use_empty=True)
    irgspp.register()
    run_state._known.clear()
    jobs.clear()
    show_jobs([])  # other tests of this process may have left some
    yield bpy.context.scene.irgspp
    irgspp.unregister()


def add_job(tmp_path: Path, **values: object) -> Job:
    """Return a job in the list, as if it had been started."""
    job = Job(**{"id": "j1", "kind": "reconstruct", "title": "Reconstruct spot", "folder": tmp_path, "notes": tmp_path} | values)
    jobs._jobs[job.id] = job
    show_jobs([one.id for one in jobs.all_jobs()])
    return job


def finished_run(folder: Path, **state: object) -> Path:
    """Write the run.json of a finished run, changed by `state`, and return the run's folder."""
    folder.mkdir(exist_ok=True)
    (folder / "run.json").write_text(json.dumps({"status": "done", "training": {"psnr": 31.5}, "skipped": []} | state))
    return folder
