# SPDX-License-Identifier: GPL-3.0-or-later
"""Terminal: progress lines and Ctrl-C."""

import io
import os
import signal
import subprocess
import sys
import time

import pytest
from irgspp.core.progress.protocol import TimeLeft
from irgspp.core.progress.terminal import BAR, Terminal, clock, progress_line


class Tty(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize(("seconds", "text"), [(0.4, "0:00"), (65, "1:05"), (3599.6, "1:00:00"), (7261, "2:01:01")])
def test_clock(seconds, text):
    assert clock(seconds) == text


def test_progress_line_has_everything():
    line = progress_line("first stage", 50, 100, 65.0, {"loss": 0.01234, "psnr": 31.5})
    for part in ("first stage", "50%", "50/100", "loss 0.0123", "PSNR 31.50 dB", "1:05 left"):
        assert part in line
    assert line.count("#") == BAR // 2


def test_terminal_keeps_one_line_up_to_date():
    stream = Tty()
    terminal = Terminal(stream)
    terminal.phase("surface", 2)
    terminal.step(2, loss=1.0)
    assert "\n" not in stream.getvalue()
    terminal.message("done")
    *_, last = stream.getvalue().split("\r")
    assert "2/2" in last
    assert last.endswith("\ndone\n")


def test_log_gets_few_lines():
    stream = io.StringIO()
    terminal = Terminal(stream)
    terminal.phase("surface", 1000)
    for done in range(1, 1001):
        terminal.step(done)
    lines = stream.getvalue().splitlines()
    assert len(lines) <= 3
    assert "1000/1000" in lines[-1]
    assert "\r" not in stream.getvalue()


def test_time_left_follows_the_recent_speed(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    left = TimeLeft(200)
    assert left.after(0) is None
    now[0] = 60.0  # one slow step (compiling)
    assert left.after(1) is None
    for done in range(2, 101):
        now[0] += 1.0
        assert left.after(done) == pytest.approx(200.0 - done)


def test_steps_from_a_checkpoint_do_not_count_as_speed(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    left = TimeLeft(200)
    assert left.after(100) is None
    now[0] = 1.0
    assert left.after(101) == pytest.approx(99.0)


def test_first_signal_cancels_and_handlers_come_back():
    before = signal.getsignal(signal.SIGINT)
    with Terminal(io.StringIO()).signals() as terminal:
        assert not terminal.cancelled
        signal.raise_signal(signal.SIGINT)
        assert terminal.cancelled
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent otherwise there")
def test_second_signal_ends_at_once():
    code = (
        "import time; from irgspp.core.progress.terminal import Terminal\n"
        "with Terminal().signals():\n"
        "    print('ready', flush=True)\n"
        "    while True: time.sleep(0.01)\n"
    )
    process = subprocess.Popen([sys.executable, "-P", "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    os.kill(process.pid, signal.SIGINT)
    assert "stopping" in process.stderr.readline() + process.stderr.readline()
    assert process.poll() is None
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=30)
    assert process.returncode == 130
