# SPDX-License-Identifier: GPL-3.0-or-later
"""The quick cases of faults and hostile input hold."""

import importlib
import sys
from pathlib import Path

import pytest

if sys.platform == "win32":
    pytest.skip("SIGKILL, mounts and limits of POSIX", allow_module_level=True)

SCRIPTS = Path(__file__).parents[2] / "scripts"

sys.path.insert(0, str(SCRIPTS))
faults = importlib.import_module("faults")
runner = importlib.import_module("stresses.runner")
case_module = importlib.import_module("stresses.case")
for name in faults.MODULES:
    importlib.import_module(f"faulting.{name}")
sys.path.remove(str(SCRIPTS))
QUICK = runner.selected(faults.CASES, quick=True, only="")


@pytest.mark.parametrize("case", QUICK, ids=lambda case: f"{case.group}: {case.name}")
def test_quick_case_holds(case, monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))  # of the processes that the case starts, too
    outcome = case_module.attempt(case)
    assert outcome.passed, outcome.faults


def test_there_are_cases_of_every_group():
    assert {case.group for case in QUICK} == set(faults.GROUPS)
    assert len({(case.group, case.name) for case in faults.CASES}) == len(faults.CASES) > len(QUICK)
