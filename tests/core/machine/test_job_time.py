# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimated time of a job: it grows with the work, and jobs that were done correct it."""

import json
from dataclasses import replace

import pytest
from irgspp.core.datasets.load import load_dataset
from irgspp.core.machine import job_time
from irgspp.core.machine.job_time import HISTORY, KEPT, estimate_seconds, in_words, record_job, reference_seconds
from irgspp.core.pipeline import DEMO_DATA
from irgspp.core.settings.schema import Settings, preset

SETTINGS = preset("balanced")


@pytest.fixture(scope="module")
def data():
    return load_dataset(DEMO_DATA)


@pytest.fixture
def history(tmp_path, monkeypatch):
    monkeypatch.setattr(job_time, "private_folder", lambda name: tmp_path)
    monkeypatch.setenv("IRGSPP_THREADS", "2")
    return tmp_path / HISTORY


def test_more_work_takes_longer(data, history):
    balanced = estimate_seconds(SETTINGS, data)
    assert estimate_seconds(preset("draft"), data) < 0.7 * balanced
    larger = replace(data, train=[*data.train, *data.train])
    assert balanced < estimate_seconds(SETTINGS, larger) < 1.5 * balanced  # steps do not grow with the photographs
    no_trial = replace(
        SETTINGS, first=replace(SETTINGS.first, stereo="on", open_edges=0.0, metal_regions="off")
    )  # no trial depends on masks
    unmasked = replace(data, train=[replace(view, alpha=None) for view in data.train])
    assert estimate_seconds(no_trial, data) < estimate_seconds(SETTINGS, data)
    assert estimate_seconds(no_trial, unmasked) > estimate_seconds(no_trial, data)


def test_photographs_are_reduced_to_the_resolution(data, history):
    side = max(data.train[0].camera.width, data.train[0].camera.height)
    seconds = [
        reference_seconds(replace(SETTINGS, data=replace(SETTINGS.data, resolution=size)), data) for size in (side // 2, side, 4 * side)
    ]
    assert seconds[0] < seconds[1] == seconds[2]


def test_jobs_that_were_done_correct_the_estimate(data, history):
    before = estimate_seconds(SETTINGS, data)
    for ratio in (3.0, 3.0, 40.0):  # the machine was busy once
        record_job(SETTINGS, data, ratio * reference_seconds(SETTINGS, data))
    assert estimate_seconds(SETTINGS, data) == pytest.approx(3 * before, rel=1e-3)
    for _ in range(KEPT):  # a new machine, say
        record_job(SETTINGS, data, 0.5 * reference_seconds(SETTINGS, data))
    assert estimate_seconds(SETTINGS, data) == pytest.approx(0.5 * before, rel=1e-3)
    assert [len(ratios) for ratios in json.loads(history.read_text()).values()] == [KEPT]


def test_threads_have_their_own_history(data, history, monkeypatch):
    slow = estimate_seconds(SETTINGS, data)
    record_job(SETTINGS, data, slow)
    monkeypatch.setenv("IRGSPP_THREADS", "8")
    assert estimate_seconds(SETTINGS, data) == pytest.approx(slow / 2)


def test_what_is_not_known_is_not_told(data, history):
    joint = replace(SETTINGS, second=replace(SETTINGS.second, solver="joint"))
    budget = replace(SETTINGS, time=60.0)
    assert estimate_seconds(joint, data) is None and estimate_seconds(budget, data) is None
    short = replace(
        Settings(materials="low-gloss"),
        first=replace(SETTINGS.first, iterations=1, open_edges=0.0),
        second=replace(SETTINGS.second, points=100, iterations=1, radiance_iterations=1, normal_iterations=1),
    )
    for settings in (joint, budget, short):
        record_job(settings, data, 100.0)
    record_job(SETTINGS, data, 2.0)  # no machine is so fast
    assert not history.exists()


@pytest.mark.parametrize(
    "damaged", ["{", "[1, 2]", '{"cpu, 2 threads": ["x"]}', '{"cpu, 2 threads": 3}', '{"cpu, 2 threads": [1e999, -1]}', "\x00"]
)
def test_a_damaged_history_starts_anew(data, history, damaged):
    expected = estimate_seconds(SETTINGS, data)
    history.write_text(damaged)
    assert estimate_seconds(SETTINGS, data) == expected
    record_job(SETTINGS, data, 2 * expected)
    assert estimate_seconds(SETTINGS, data) == pytest.approx(2 * expected, rel=1e-3)


def test_durations_are_as_precise_as_an_estimate():
    assert [in_words(seconds) for seconds in (3, 44, 89, 130, 5399, 9000)] == ["10 s", "40 s", "90 s", "2 min", "90 min", "2.5 h"]
