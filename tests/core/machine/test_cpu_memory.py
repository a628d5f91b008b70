# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimated memory of a job against the free memory: fewer rays at once, or an error of one line; the results are the same."""

import sys

import numpy as np
import pytest
import torch
from irgspp.core.datasets.load import load_dataset
from irgspp.core.errors import InputError
from irgspp.core.machine import cpu_memory
from irgspp.core.machine.cpu_memory import FEWEST_RAYS, MOST_RAYS, FreeMemory, estimate_memory, free_memory, rays_that_fit
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.settings.schema import preset
from irgspp.core.stages.second.solver import transfer_tracing

MIB = 1 << 20


@pytest.fixture(scope="module")
def data():
    return load_dataset(DEMO_DATA)


def test_more_of_anything_needs_more(data):
    sizes = [estimate_memory(preset(name), data.pixels()) for name in ("draft", "balanced", "paper")]
    assert 800 * MIB < sizes[0] <= sizes[1] < sizes[2]
    assert estimate_memory(preset("draft"), data.pixels(), FEWEST_RAYS) < sizes[0] - 200 * MIB


def test_rays_are_as_many_as_fit(data, monkeypatch):
    settings, used = preset("draft"), 300 * MIB
    monkeypatch.setattr(cpu_memory, "resident_memory", lambda: used)  # the process of other tests may use more than the job needs
    most, least = (estimate_memory(settings, data.pixels(), rays) - used for rays in (MOST_RAYS, FEWEST_RAYS))
    assert rays_that_fit(settings, data.pixels(), FreeMemory(2 * most, "plenty")) == MOST_RAYS
    assert FEWEST_RAYS <= rays_that_fit(settings, data.pixels(), FreeMemory((most + least) // 2 + 60 * MIB, "some")) < MOST_RAYS
    with pytest.raises(InputError, match=r"memory: the job needs about \d\.\d GiB, but .* available \(too little\); close other programs"):
        rays_that_fit(settings, data.pixels(), FreeMemory(1, "too little"))


@pytest.mark.parametrize("version", [0, 1])
def test_limits_of_cgroups_are_known(tmp_path, monkeypatch, version):
    monkeypatch.setattr(cpu_memory, "CGROUP", tmp_path)
    limit, usage = (tmp_path / name for name in cpu_memory.CGROUPS[version])
    limit.parent.mkdir(exist_ok=True)
    limit.write_text(f"{3 * MIB}\n")
    usage.write_text(f"{MIB}\n")
    assert free_memory() == FreeMemory(2 * MIB, "the limit of its cgroup")
    limit.write_text("max\n" if version == 0 else f"{(1 << 63) - 4096}\n")
    assert "cgroup" not in free_memory().limit


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_limits_of_the_process_are_known(monkeypatch):
    import resource

    monkeypatch.setattr(resource, "getrlimit", lambda kind: (1 << 20, 1 << 20) if kind == resource.RLIMIT_AS else (-1, -1))
    assert free_memory() == FreeMemory(0, "the limit of this process, ulimit -v")


def test_fewer_rays_at_once_give_the_same_result():
    """A stand-in tracer counts its calls, since only the batches differ."""

    class CountingTracer:
        calls = 0

        def look(self, origin, direction):
            self.calls += 1
            return direction[:, 0] * origin[:, 1], direction * origin

    random = np.random.default_rng(0)
    origin, direction = (torch.from_numpy(random.normal(size=s).astype(np.float32)) for s in ((20, 3), (3, 50)))
    selected, results, tracer = origin @ direction > 0, [], CountingTracer()
    for rays in (MOST_RAYS, 100):
        with transfer_tracing.rays_at_a_time(rays):
            results.append(transfer_tracing._trace_directions(origin, direction, selected, tracer, lambda done: None))
    assert transfer_tracing.RAY_BATCH == MOST_RAYS and tracer.calls == 1 + 5
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))
