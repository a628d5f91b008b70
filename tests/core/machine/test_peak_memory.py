# SPDX-License-Identifier: GPL-3.0-or-later
"""Peak memory on Windows; tests/core/test_run_folder.py measures it on the system that the tests run on."""

import sys
from types import SimpleNamespace

import psutil
from irgspp.core.machine.peak_memory import peak_memory


def test_windows_reports_the_peak_working_set(monkeypatch):
    counters = SimpleNamespace(rss=5, peak_wset=7)
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(psutil, "Process", lambda: SimpleNamespace(memory_info=lambda: counters))
    assert peak_memory() == 7
