# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole job with the GPU kernels on an emulated GPU: no tensor stays on the CPU or is passed to numpy; the result agrees with numba."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from irgspp.core import pipeline
from irgspp.core.pipeline import reconstruct
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.second.solver import solver_run
from small_scenes import small_scene
from unwrapped_here import unwrap_here

SCENE = small_scene("bowl")  # it has half as many views as the demo's
EMULATED = Path(__file__).resolve().parents[2] / "support" / "emulated_gpu.py"
TINY = [
    "materials=glossy", "first.gaussians=1500", "first.iterations=40", "first.trial_iterations=4",
    "first.trial_gaussians=400", "second.points=150", "second.rows=6", "second.views=4", "second.iterations=4",
    "second.pixels=32", "second.samples=8", "second.pool=1000", "second.radiance_iterations=3", "second.normal_iterations=8",
    "surface.voxels=32", "surface.triangles=600", "surface.texture=64",
]  # fmt: skip


@pytest.mark.long(seconds=40)
def test_a_whole_job_runs_and_agrees_with_numba(tmp_path, monkeypatch):
    """In a process of its own, as torch can't remove the emulated GPU again."""
    pytest.importorskip("warp")
    words = [sys.executable, str(EMULATED), str(SCENE), str(tmp_path / "gpu"), *TINY]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env={**os.environ, "OMP_NUM_THREADS": "1"})
    assert done.returncode == 0, done.stderr[-3000:]
    monkeypatch.setattr(pipeline, "write_blend", lambda *_: None)
    unwrap_here(monkeypatch)
    monkeypatch.setattr(solver_run, "START_STEPS", 6)  # as there
    reconstruct(SCENE, tmp_path / "cpu", with_overrides(preset("balanced"), [*TINY, "device=cpu"]))
    states = [json.loads((tmp_path / name / "run.json").read_text()) for name in ("gpu", "cpu")]
    assert [state["computed_on"]["device"] for state in states] == ["emulated:0", "cpu"]
    found, expected = (state["training"]["test_radiance_psnr"] for state in states)
    assert found == pytest.approx(expected, abs=0.3) and expected > 15
