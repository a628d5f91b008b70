# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs on a cluster whose workers die or go away; the cluster is a stand-in that returns given futures."""

import pytest
from irgspp.core.batch.job_runner import CANCEL
from irgspp.core.batch.job_state import JobFolder, State
from irgspp.core.batch.jobs import Job
from irgspp.core.batch.workers import RESUBMISSIONS, DaskPool


class KilledWorker(Exception):
    """Named like dask's own."""


class Future:
    def __init__(self, status, value):
        self.status, self.value = status, value

    def done(self):
        return self.status != "pending"

    def result(self):
        return self.value

    def exception(self):
        return self.value

    def cancel(self):
        self.status = "cancelled"


class Cluster:
    """Answers with one after the other."""

    def __init__(self, *futures):
        self.futures, self.keys = list(futures), []

    def submit(self, function, job, batch, key, pure):
        self.keys.append(key)
        return self.futures.pop(0)


@pytest.fixture
def job(tmp_path):
    return Job("a", tmp_path / "run", (("reconstruct", "d", "-o", "run"),), tmp_path)


def test_a_job_that_dask_gave_up_is_given_out_again(job, tmp_path):
    cluster = Cluster(Future("error", KilledWorker("a")), Future("finished", State("done")))
    handle = DaskPool(cluster, tmp_path).submit(job)
    assert not handle.done() and handle.done()
    assert handle.result() == State("done") and len(set(cluster.keys)) == 2


def test_a_job_that_always_takes_its_worker_with_it_has_failed(job, tmp_path):
    cluster = Cluster(*(Future("error", KilledWorker("died  of\nit")) for _ in range(RESUBMISSIONS + 1)))
    handle = DaskPool(cluster, tmp_path).submit(job)
    assert [handle.done() for _ in range(RESUBMISSIONS + 1)] == [False] * RESUBMISSIONS + [True]
    assert handle.result() == State("failed", "on the cluster: died of it")


def test_a_fault_is_not_tried_twice(job, tmp_path):
    handle = DaskPool(Cluster(Future("error", ValueError("no folder"))), tmp_path).submit(job)
    assert handle.done() and handle.result() == State("failed", "on the cluster: no folder")


def test_what_nobody_has_begun_with_is_taken_back(job, tmp_path):
    JobFolder(tmp_path / "a").prepare()
    handle = DaskPool(Cluster(Future("pending", None)), tmp_path).submit(job)
    JobFolder(tmp_path / "a").write(State("running"))
    handle.withdraw()
    assert not handle.done()  # it stops by itself
    JobFolder(tmp_path / "a").write(State("waiting"))
    handle.withdraw()
    assert handle.done() and handle.result() == State("failed", "on the cluster: cancelled")  # nobody asked for it
    (tmp_path / CANCEL).touch()
    assert handle.result() == State("cancelled")
