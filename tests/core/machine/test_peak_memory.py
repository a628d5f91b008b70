# SPDX-License-Identifier: GPL-3.0-or-later
"""Peak memory: measured on the system that the tests run on, and what Windows reports."""

import sys
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from irgspp.core.machine.peak_memory import peak_memory, reset_peak_memory


def test_windows_reports_the_peak_working_set(monkeypatch):
    counters = SimpleNamespace(rss=5, peak_wset=7)
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(psutil, "Process", lambda: SimpleNamespace(memory_info=lambda: counters))
    assert peak_memory() == 7


def test_peak_memory_sees_an_allocation_and_forgets_it():
    if not reset_peak_memory():
        pytest.skip("the peak can't be reset on this system")
    before = peak_memory()
    block = np.ones(50_000_000)
    peak = peak_memory()
    assert peak >= before + block.nbytes * 0.9
    del block
    reset_peak_memory()
    assert peak_memory() < peak
