# SPDX-License-Identifier: GPL-3.0-or-later
"""The quick cases of the numerical stress test hold, and a case that does not hold is reported."""

import json

import pytest
from scripts_folder import scripts_on_path

with scripts_on_path() as script:
    stress, runner, case_module = script("stress"), script("stresses.runner"), script("stresses.case")
    for name in stress.GROUPS:
        script(f"stresses.{name}")
QUICK = runner.selected(case_module.CASES, quick=True, only="")


@pytest.mark.parametrize("case", QUICK, ids=lambda case: f"{case.group}: {case.name}")
def test_quick_case_holds(case):
    outcome = case_module.attempt(case)
    assert outcome.passed, outcome.faults


def test_there_are_cases_of_every_group():
    assert {case.group for case in QUICK} == set(stress.GROUPS)
    assert len({(case.group, case.name) for case in case_module.CASES}) == len(case_module.CASES) > len(QUICK)


@pytest.fixture
def only_these(monkeypatch):
    """Return a function that replaces all cases."""

    def install(**cases):
        made = [case_module.Case("made up", name, "two is at most one", run) for name, run in cases.items()]
        monkeypatch.setattr(stress, "CASES", made)

    return install


def test_a_case_that_fails_shows_everywhere(only_these, tmp_path, capsys):
    only_these(
        good=lambda measured: measured.at_most("one", 1, 1),
        bad=lambda measured: measured.at_most("two", 2, 1),
        broken=lambda measured: [][0],
        nothing=lambda measured: measured.at_most("no number", float("nan"), 1),
    )
    assert stress.main(["-o", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "1 of 4 cases hold" in said
    assert "FAILS made up: bad: two 2 (at most 1)" in said and "FAILS made up: broken: IndexError" in said
    record = {entry["case"]: entry for entry in json.loads((tmp_path / "stress.json").read_text())["cases"]}
    assert [record[name]["passed"] for name in ("good", "bad", "broken", "nothing")] == [True, False, False, False]
    page = (tmp_path / "stress.html").read_text()
    assert page.count('class="fails"') == 3 and "two 2 (at most 1)" in page


def test_exit_status_says_whether_all_hold(only_these, capsys):
    only_these(good=lambda measured: measured.at_least("one", 1, 1))
    assert stress.main([]) == 0
    assert stress.main(["--only", "no such case"]) == 2
    assert "no such case" in capsys.readouterr().err
