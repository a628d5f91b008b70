# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels that are timed against each other compute the same."""

import numpy as np
import pytest
from scripts_folder import scripts_on_path


@pytest.fixture(scope="module")
def script():
    with scripts_on_path() as script:
        yield script("benchmarks.workloads")


@pytest.mark.parametrize("threads", ["1", "2"])
def test_vector_and_plain_kernels_agree(script, threads, monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", threads)
    splats = script.project(2000, 61, seed=3)
    difference = script.disagreement(splats, script.RASTER)
    assert difference["picture"] < 1e-4 and difference["gradient"] < 1e-4
    channels = 8 + script.EXTRAS
    opacity = splats.image.reshape(channels + 1, splats.columns * 8, splats.columns * 8)[channels - 1]
    assert channels == 12 and 0.2 < (opacity > 0.98).mean() < 0.8  # the torus is there
    assert abs(splats.slots).max() > 0


@pytest.mark.parametrize("threads", ["1", "2"])
def test_vector_and_plain_traces_agree(script, threads, monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", threads)
    rays = script.scatter(2000, 5000, seed=3)
    lists = []
    for forward, _ in script.TRACE.values():
        rays.forward(forward)
        lists.append([a.copy() for a in (*rays.hits, rays.image)])
    vector, plain = lists
    assert 1 < rays.count.mean() < 20
    same = np.diff(vector[0]) == np.diff(plain[0])
    assert same.mean() > 0.999  # a ray on a threshold may fall to either side
    assert np.median(abs(vector[-1] - plain[-1])[same]) < 1e-6
    assert script.disagreement(rays, script.TRACE)["gradient"] < 1e-3
    assert abs(rays.slots).max() > 0
