# SPDX-License-Identifier: GPL-3.0-or-later
"""Child process of a batch: it waits for its lock, and ends with its parent."""

import subprocess
import sys

import pytest
from irgspp.core.io.file_lock import FileLock
from irgspp.core.machine.blender_process import LAUNCHER


def start(lock, *words: str) -> subprocess.Popen:
    command = [sys.executable, str(LAUNCHER), "core.cli.batch_child", str(lock), *words]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_it_waits_for_a_process_that_still_works_on_the_job(tmp_path):
    held = FileLock(tmp_path / "lock")
    child = start(tmp_path / "lock", "inspect", str(tmp_path / "missing"))
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.5)
    held.release()
    assert child.wait(120) == 2 and "missing" in child.communicate()[1]


def test_it_stops_waiting_when_its_parent_ends(tmp_path):
    held = FileLock(tmp_path / "lock")
    child = start(tmp_path / "lock", "inspect", str(tmp_path / "missing"))
    _, error = child.communicate(timeout=60)  # closes its stdin
    held.release()
    assert (child.returncode, error) == (130, "")
