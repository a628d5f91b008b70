# SPDX-License-Identifier: GPL-3.0-or-later
"""The quick cases of faults and hostile input hold, but for fuzzing and memory, which scripts/faults.py has alone."""

import importlib
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"

sys.path.insert(0, str(SCRIPTS))
faults = importlib.import_module("faults")
stress = importlib.import_module("stress")
case_module = importlib.import_module("stresses.case")
for name in faults.GROUPS:
    importlib.import_module(f"faulting.{name}")
sys.path.remove(str(SCRIPTS))
QUICK = stress.selected(faults.CASES, quick=True, only="")
HERE = [case for case in QUICK if case.group not in ("fuzz", "memory")]  # fuzzing forks, memory is measured: both need a process alone
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL, mounts and limits of POSIX")


@POSIX
@pytest.mark.parametrize("case", HERE, ids=lambda case: f"{case.group}: {case.name}")
def test_quick_case_holds(case, monkeypatch):
    monkeypatch.syspath_prepend(str(SCRIPTS))  # of the processes that the case starts, too
    outcome = case_module.attempt(case)
    assert outcome.passed, outcome.faults


def test_there_are_cases_of_every_group():
    assert {case.group for case in QUICK} == set(faults.GROUPS)
    assert len({(case.group, case.name) for case in faults.CASES}) == len(faults.CASES) > len(QUICK)
