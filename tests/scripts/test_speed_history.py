# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of the history of speed: comparison of entries, its file, and its works, which are called once and not timed."""

import json

import pytest
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    speed_history, speed_works = script("speed_history"), script("benchmarks.speed_works")


def entry(commit="abc", **cpu):
    return {"commit": commit, "date": "2026-01-02", "works": {name: {"cpu": value, "wall": value} for name, value in cpu.items()}}


def test_only_works_beyond_the_tolerance_count_as_slower():
    last, now = entry(step=100.0, rays=10.0, gone=1.0), entry(step=124.0, rays=12.6, new=5.0)
    assert speed_history.slower(now, last) == ["rays"]
    assert speed_history.slower(last, last) == []


def test_table_shows_changes_and_marks_what_is_slower():
    text = speed_history.table(entry(step=50.0, rays=13.0, new=5.0), entry("old", step=100.0, rays=10.0))
    assert "compared with old" in text
    assert "| step | 50.0 | 50.0 | -50% |" in text
    assert "| rays | 13.0 | 13.0 | +30% slower |" in text
    assert "| new | 5.0 | 5.0 | – |" in text


@pytest.fixture
def measured(monkeypatch):
    """Replace the measurement by numbers of the test."""
    found = {"step": {"cpu": 60.0, "wall": 100.0}}
    monkeypatch.setattr(speed_history, "ratios", lambda repeats: found)
    return found


def test_entries_are_appended_only_where_asked_for(measured, tmp_path, capsys):
    file = tmp_path / "history.json"
    assert speed_history.main(["--file", str(file)]) == 0
    assert not file.exists()
    assert speed_history.main(["--file", str(file), "--record"]) == 0
    measured["step"] = {"cpu": 60.0, "wall": 200.0}
    assert speed_history.main(["--file", str(file), "--record"]) == 1  # twice as slow
    assert [e["works"]["step"]["wall"] for e in json.loads(file.read_text())] == [100.0, 200.0]
    assert "+100% slower" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["{", "[1]", '[{"commit": "a"}]'])
def test_damaged_file_is_refused_before_measuring(text, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(speed_history, "ratios", lambda repeats: pytest.fail("measured"))
    file = tmp_path / "history.json"
    file.write_text(text)
    assert speed_history.main(["--file", str(file)]) == 2
    assert str(file) in capsys.readouterr().err


def test_no_repeats_are_refused(capsys):
    with pytest.raises(SystemExit) as end:
        speed_history.main(["--repeats", "0"])
    assert end.value.code == 2
    assert "--repeats must be at least 1" in capsys.readouterr().err


def test_median_of_the_calls_after_the_first():
    calls = []
    seconds = speed_history._median_seconds({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 3)
    assert calls == ["a", "b"] * 4
    assert seconds["a"].shape == (2,)
    assert (seconds["a"] >= 0).all()


def test_works_run(monkeypatch):
    """Every work but the whole job, which the tests of the pipeline run, does its work."""
    monkeypatch.setattr(speed_works, "SURFELS", 500)
    monkeypatch.setattr(speed_works, "PIXELS", 24)
    monkeypatch.setattr(speed_works, "RAYS", 256)
    monkeypatch.setattr(speed_works, "ELEMENTS", 1 << 10)
    for name, work in (speed_works.references() | speed_works.works()).items():
        if name != "demo, whole job":
            work()
