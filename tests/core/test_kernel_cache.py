# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels are compiled beforehand once, quietly, and the mark that says so is left by a finished job alone."""

import os
import subprocess
import sys

import pytest
from irgspp.core import kernel_cache
from irgspp.core.errors import Cancelled
from irgspp.core.kernel_cache import ABOUT, fill_kernel_cache
from irgspp.core.progress.protocol import Silent


class Recorded(Silent):
    """Progress with the phases and the steps."""

    def __init__(self) -> None:
        self.phases, self.steps = [], []

    def phase(self, name: str, steps: int) -> None:
        self.phases.append((name, steps))

    def step(self, done: int, **metrics: float) -> None:
        self.steps.append(done)


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    """Jobs that are started instead of run; each compiles as many kernels as `compiles` says, or raises it."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    started = []

    class Jobs(list):
        compiles: int | Exception = 2

    jobs = Jobs()

    def run(dataset, folder, settings, *, progress):
        jobs.append((dataset, settings, progress))
        assert folder.parent.is_dir()
        if isinstance(jobs.compiles, Exception):
            raise jobs.compiles
        for _ in range(jobs.compiles):
            started[-1]()

    monkeypatch.setattr(kernel_cache, "reconstruct", run)
    reported = kernel_cache.compilations_reported
    monkeypatch.setattr(kernel_cache, "compilations_reported", lambda report: (started.append(report), reported(report))[1])
    return jobs


def test_kernels_are_compiled_once(jobs):
    progress = Recorded()
    assert fill_kernel_cache(progress) == 2
    assert progress.phases == [("compile kernels", ABOUT)]
    assert progress.steps == [1, 2, ABOUT]
    assert fill_kernel_cache(progress) == 0
    assert len(jobs) == 1


def test_the_job_is_one_on_the_cpu_that_little_is_asked_of(jobs):
    fill_kernel_cache(Recorded())
    (dataset, settings, _), *_ = jobs
    assert dataset == kernel_cache.DEMO_DATA
    assert (settings.device, settings.materials, settings.pace) == ("cpu", "glossy", 0.01)


def test_cancelling_reaches_the_job_and_leaves_no_mark(jobs, tmp_path):
    jobs.compiles, progress = Cancelled("stopped"), Recorded()
    with pytest.raises(Cancelled):
        fill_kernel_cache(progress)
    inner = jobs[0][2]
    assert not inner.cancelled
    progress.cancelled = True
    assert inner.cancelled
    assert not list(tmp_path.glob("filled-*"))


def test_numba_is_imported_with_its_cache_folder_set(tmp_path):
    """Kernels would otherwise be kept beside the sources, where no job looks for them."""
    code = "import irgspp.core.kernel_cache, numba, os; print(numba.config.CACHE_DIR == os.environ['NUMBA_CACHE_DIR'])"
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | {"IRGSPP_CACHE": str(tmp_path)}
    asked = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert asked.stdout.strip() == "True"
