# SPDX-License-Identifier: GPL-3.0-or-later
"""On a GPU, a step of an optimisation uses no tensor on the CPU and never makes the host wait for a value."""

import subprocess
import sys
from pathlib import Path

import pytest

PRETENDED = Path(__file__).resolve().parents[3] / "support" / "pretended_gpu.py"


def test_steps_of_both_stages_never_wait():
    """The steps run in a process of their own, as torch cannot unregister the pretended GPU."""
    pytest.importorskip("warp")
    done = subprocess.run([sys.executable, str(PRETENDED)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    started = set(done.stdout.split())
    assert {"project", "project_backward", "compare", "gradient_of", "blend", "blend_backward", "step_on", "shade_backward"} <= started
    assert any(name.endswith("see") for name in started)  # rays
