# SPDX-License-Identifier: GPL-3.0-or-later
"""The two rasterisers that are timed against each other do the same."""

import importlib
import json
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture(scope="module")
def script():
    sys.path.insert(0, str(SCRIPTS))
    yield importlib.import_module("benchmark_kernels")
    sys.path.remove(str(SCRIPTS))


@pytest.mark.parametrize("threads", ["1", "2"])
def test_vector_and_plain_kernels_agree(script, threads, monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", threads)
    splats = script.project(2000, 61, seed=3)
    difference = script.disagreement(splats)
    assert difference["picture"] < 1e-4 and difference["gradient"] < 1e-4
    channels = 8 + script.EXTRAS
    opacity = splats.picture.reshape(channels + 1, splats.columns * 8, splats.columns * 8)[channels - 1]
    assert channels == 12 and 0.2 < (opacity > 0.98).mean() < 0.8  # the torus is there
    assert abs(splats.slots).max() > 0


def test_figures_are_written(script, tmp_path, monkeypatch, capsys):
    path = tmp_path / "figures.json"
    monkeypatch.setattr(sys, "argv", ["benchmark", "--disks", "500", "--size", "40", "--repetitions", "1", "--json", str(path)])
    script.main()
    (figures,) = json.loads(path.read_text())
    assert figures["disks"] == 500 and figures["ratio"] > 0
    assert "vector" in capsys.readouterr().out
