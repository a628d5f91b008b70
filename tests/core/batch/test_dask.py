# SPDX-License-Identifier: GPL-3.0-or-later
"""A cluster of two workers, of which the one that runs the job is killed: the other one resumes from the job's checkpoint."""

import json
import os
import signal
import sys
import threading
import time

import pytest
from irgspp.core.batch.batch import run_batch
from irgspp.core.batch.job_state import JobFolder
from irgspp.core.batch.jobs import read_jobs
from irgspp.core.cli.parser import check_words
from irgspp.core.errors import Cancelled
from small_scenes import small_scene

distributed = pytest.importorskip("distributed")

ENDLESS = ("materials=low-gloss", "first.iterations=100000", "first.gaussians=1000", "data.resolution=32")
SCENE = small_scene("bowl")
PATIENCE = 300  # seconds on a machine that has other things to do


@pytest.fixture(scope="module")
def cluster():
    """Two workers; afterwards the environment is as before, as dask leaves OMP_NUM_THREADS=1 for the processes of other tests."""
    before = dict(os.environ)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        yield cluster
    os.environ.clear()
    os.environ.update(before)


def steps_of(run) -> list[int]:
    """Return the optimisation steps in the run's event log, in order."""
    file = run / "events.jsonl"
    events = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    return [event["step"] for event in events if "loss" in event]


def worker_at_work(cluster) -> str:
    """Return the address of the worker that has a job."""
    return next(address for address, worker in cluster.scheduler.workers.items() if worker.processing)


def until(condition, what: str) -> None:
    ends = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < ends, what
        time.sleep(0.1)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_a_job_whose_worker_is_killed_goes_on_elsewhere(cluster, tmp_path):
    overrides = ", ".join(f'"{text}"' for text in ENDLESS)
    (tmp_path / "jobs.toml").write_text(f'[[job]]\ndataset = "{SCENE}"\noutput = "run"\npreset = "draft"\nset = [{overrides}]\n')
    jobs, run, enough = read_jobs(tmp_path / "jobs.toml", check_words), tmp_path / "run", threading.Event()
    ends: list[Exception] = []

    def batch() -> None:
        try:
            run_batch(jobs, tmp_path / "jobs.batch", enough.is_set, dask=cluster.scheduler_address)
        except Cancelled as error:
            ends.append(error)

    thread = threading.Thread(target=batch)
    thread.start()
    try:
        until(lambda: len(steps_of(run)) >= 2, "the job does not get going")
        killed = worker_at_work(cluster)
        with distributed.Client(cluster, set_as_default=False) as client:
            (number,) = client.run(os.getpid, workers=[killed]).values()
        os.kill(number, signal.SIGKILL)
        until(lambda: (run / "log.txt").read_text().count("first stage: 100000 steps") == 2, "nobody took over")
        before = len(steps_of(run))
        until(lambda: len(steps_of(run)) >= before + 2, "the other worker does not get going")
        assert worker_at_work(cluster) != killed
    finally:
        enough.set()
        thread.join()
    assert len(ends) == 1 and JobFolder(tmp_path / "jobs.batch" / "run").read().state == "cancelled"
    assert json.loads((run / "run.json").read_text())["status"] == "cancelled"
    steps = steps_of(run)
    assert steps == sorted(set(steps)) and steps[-1] > 2  # no step was done twice
