# SPDX-License-Identifier: GPL-3.0-or-later
"""The thread pool distributes every item once, evenly, and always the same way."""

import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from irgspp.core.errors import Cancelled
from irgspp.core.machine.thread_pool import balanced_ranges, even_ranges, run_jobs, run_ranges, run_reported, thread_count
from irgspp.core.progress.protocol import Silent


def covers(ranges, count):
    return [i for a, b in ranges for i in range(a, b)] == list(range(count)) and all(b > a for a, b in ranges)


@given(count=st.integers(0, 500), parts=st.integers(1, 40))
def test_even_ranges_cover_once(count, parts):
    ranges = even_ranges(count, parts)
    assert covers(ranges, count)
    assert len(ranges) == min(parts, count)
    sizes = [b - a for a, b in ranges]
    assert not sizes or max(sizes) - min(sizes) <= 1


@given(cost=st.lists(st.integers(0, 1000), max_size=300), parts=st.integers(1, 40))
def test_balanced_ranges_cover_once_and_balance(cost, parts):
    cost = np.array(cost, np.int64)
    ranges = balanced_ranges(cost, parts)
    assert covers(ranges, len(cost)) and len(ranges) <= parts
    if len(cost) and cost.sum():
        assert max(cost[a:b].sum() for a, b in ranges) <= cost.sum() / parts + 2 * cost.max()
    assert ranges == balanced_ranges(cost.copy(), parts)


@pytest.mark.parametrize("threads", [1, 3])
def test_every_item_is_worked_on_once(threads, monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", str(threads))
    assert thread_count() == threads
    done, slots, workers = np.zeros(1000, int), np.full(1000, -1), set()

    def work(slot, begin, end, scale):
        workers.add(threading.get_ident())
        done[begin:end] += scale
        slots[begin:end] = slot

    ranges = even_ranges(1000, 7)
    run_ranges(work, ranges, 5, numbered=True)
    assert (done == 5).all() and len(workers) <= threads
    assert all((slots[a:b] == i).all() for i, (a, b) in enumerate(ranges))


def test_no_work_is_no_call():
    run_ranges(lambda *_: pytest.fail("called"), [])


@pytest.mark.parametrize("parts", [1, 4])
def test_failure_in_a_thread_is_raised(parts):
    def work(begin, end):
        if end == 100:
            raise ValueError("last")

    with pytest.raises(ValueError, match="last"):
        run_ranges(work, even_ranges(100, parts))


def test_one_thread_at_least(monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", "0")
    assert thread_count() == 1
    monkeypatch.delenv("IRGSPP_THREADS")
    assert thread_count() >= 1


@pytest.mark.parametrize("threads", [1, 3])
def test_jobs_give_their_results_in_order(threads, monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", str(threads))
    assert list(run_jobs(lambda a, b: a - b, [(i, 1) for i in range(20)])) == list(range(-1, 19))


def test_jobs_that_have_not_begun_are_dropped(monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", "2")
    begun = []
    results = run_jobs(lambda i: (begun.append(i), time.sleep(0.01)), [(i,) for i in range(100)])
    next(results)
    results.close()
    count = len(begun)
    time.sleep(0.1)
    assert count == len(begun) < 50


def test_a_failed_job_raises_its_error(monkeypatch):
    monkeypatch.setenv("IRGSPP_THREADS", "2")
    with pytest.raises(ZeroDivisionError):
        list(run_jobs(lambda i: 1 // (i - 3), [(i,) for i in range(10)]))


class Steps(Silent):
    """Progress that keeps the steps, and cancels at one of them."""

    def __init__(self, stop=None):
        self.steps, self._stop = [], stop

    def step(self, done, **metrics):
        self.steps.append(done)
        self.cancelled = done == self._stop


def test_reported_items_are_steps_in_order():
    progress = Steps()
    assert run_reported(lambda i: i * i, range(20), 3, progress, "stopped") == [i * i for i in range(20)]
    assert progress.steps == list(range(1, 21))


def test_cancelled_items_are_dropped():
    begun = []

    def work(i):
        begun.append(i)
        time.sleep(0.01)

    with pytest.raises(Cancelled, match="stopped while counting"):
        run_reported(work, range(200), 2, Steps(2), "stopped while counting")
    assert len(begun) < 50


def test_error_of_an_item_is_raised():
    with pytest.raises(ZeroDivisionError):
        run_reported(lambda i: 1 // i, [1, 0, 2], 2, Silent(), "stopped")
