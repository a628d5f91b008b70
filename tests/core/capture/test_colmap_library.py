# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP in a process: quiet, also when the process is terminated; its long calls report steps and can be cancelled."""

import os
import signal
import subprocess
import sys
import threading

import pytest
from irgspp.core.capture.colmap_library import run_call
from irgspp.core.errors import Cancelled
from irgspp.core.progress.protocol import Silent

QUIET = """
import os, pathlib, signal, sys, pycolmap
from irgspp.core.capture.colmap_library import silence
silence()
pycolmap.logging.warning("a warning of COLMAP")
try:
    pycolmap.Reconstruction(sys.argv[1])
except (ValueError, RuntimeError):
    print("refused", flush=True)
os.kill(os.getpid(), signal.SIGTERM)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM between processes")
def test_colmap_is_quiet_also_when_terminated(tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run([sys.executable, "-c", QUIET, tmp_path / "none"], capture_output=True, text=True, env=environment, timeout=120)
    assert (done.stdout, done.stderr, done.returncode) == ("refused\n", "", -signal.SIGTERM)


def test_a_long_call_reports_steps_and_returns_its_result():
    seen = []

    class Steps(Silent):
        def step(self, done, **metrics):
            seen.append(done)

    reported, progress = threading.Event(), Steps()

    def count():
        reported.set()
        return 7

    assert run_call(lambda token: reported.wait(20) and "result", progress, "stopped", count) == "result"
    assert seen == [7]


def test_a_cancelled_call_is_stopped():
    class Stopped(Silent):
        cancelled = True

    def call(token):
        while not token.is_cancelled:
            threading.Event().wait(0.01)

    with pytest.raises(Cancelled, match="stopped while waiting"):
        run_call(call, Stopped(), "stopped while waiting")


def test_errors_of_the_receiver_stop_the_call():
    stopped = threading.Event()

    class Broken(Silent):
        def step(self, done, **metrics):
            raise RuntimeError("receiver")

    def call(token):
        while not token.is_cancelled:
            threading.Event().wait(0.01)
        stopped.set()

    with pytest.raises(RuntimeError, match="receiver"):
        run_call(call, Broken(), "stopped", lambda: 3)
    assert stopped.is_set()


def test_errors_of_a_call_are_raised():
    def call(token):
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        run_call(call, Silent(), "stopped")
