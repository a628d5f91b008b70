# SPDX-License-Identifier: GPL-3.0-or-later
"""The watch calls back at the end of stdin, not at data before it, and never in a process without stdin."""

import subprocess
import sys

import pytest

WATCH = """
import os, time
{first}
from irgspp.core.machine.parent_watch import on_parent_exit
on_parent_exit(lambda: os._exit(7))
print("watching", flush=True)
time.sleep({seconds})
"""


def start(first: str, seconds: float) -> subprocess.Popen:
    command = [sys.executable, "-c", WATCH.format(first=first, seconds=seconds)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def test_the_end_is_noticed_and_what_comes_before_is_not_the_end():
    child = start("", 60)
    assert child.stdout.readline() == b"watching\n"
    child.stdin.write(b"not the end")
    child.stdin.flush()
    with pytest.raises(subprocess.TimeoutExpired):
        child.wait(0.3)
    child.stdin.close()
    assert child.wait(30) == 7
    child.stdout.close()


def test_no_stdin_has_no_end():
    child = start("os.close(0)", 0.3)
    assert child.communicate()[0] == b"watching\n" and child.returncode == 0
