# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands of the engine in the foreground: their exit status is returned, and interrupts of this process stop them in order."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from irgspp.irgspp_addon.engine.foreground import run_here

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals as on POSIX")

PATIENT = """
import os, signal, sys, time
from pathlib import Path
job, notes = Path(os.environ["IRGSPP_JOB"]), Path(sys.argv[1])
notes.write_text("began")
end = time.time() + 60
while time.time() < end and not (job / "cancel").exists():
    time.sleep(0.02)
notes.write_text("saved")
sys.exit(130)
"""
DEAF = "import sys, time\nfrom pathlib import Path\nPath(sys.argv[1]).write_text('began')\ntime.sleep(60)\n"


@pytest.fixture
def command(tmp_path):
    """Return a function that writes a script and returns its command line, with the path of `notes` as argument."""

    def make(text: str) -> list[str]:
        (tmp_path / "script.py").write_text(text)
        return [sys.executable, str(tmp_path / "script.py"), str(tmp_path / "notes")]

    return make


def signal_when_begun(notes: Path, *kinds: signal.Signals) -> None:
    """Send signals to this process, 0.3 seconds apart, after the script has begun."""

    def send():
        wait_for(notes, "began")
        for kind in kinds:
            os.kill(os.getpid(), kind)
            time.sleep(0.3)

    threading.Thread(target=send, daemon=True).start()


def wait_for(notes: Path, text: str, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not notes.exists() or notes.read_text() != text:
        assert time.monotonic() < end, f"{notes} does not contain {text!r}"
        time.sleep(0.02)


@pytest.mark.parametrize("status", [0, 1, 2, 130])
def test_exit_status_is_returned(command, status):
    assert run_here(command(f"import sys; sys.exit({status})"), os.environ) == status


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_one_signal_to_this_process_stops_the_engine_in_order(command, tmp_path, kind):
    before = signal.getsignal(kind)
    signal_when_begun(tmp_path / "notes", kind)
    assert run_here(command(PATIENT), os.environ) == 130
    assert (tmp_path / "notes").read_text() == "saved"
    assert signal.getsignal(kind) is before


def test_second_signal_kills_an_engine_that_does_not_stop(command, tmp_path):
    signal_when_begun(tmp_path / "notes", signal.SIGTERM, signal.SIGTERM)
    began = time.monotonic()
    assert run_here(command(DEAF), os.environ) == 130
    assert time.monotonic() - began < 30


def test_crash_is_a_failure_with_a_message(command, capfd):
    assert run_here(command("import os, signal; os.kill(os.getpid(), signal.SIGKILL)"), os.environ) == 1
    assert "irgspp: the engine was ended by SIGKILL" in capfd.readouterr().err


def test_engine_stops_in_order_when_this_process_is_killed(command, tmp_path):
    words = command(PATIENT)
    code = f"import os; from irgspp.irgspp_addon.engine.foreground import run_here; run_here({words!r}, os.environ)"
    parent = subprocess.Popen([sys.executable, "-c", code])
    wait_for(tmp_path / "notes", "began")
    parent.kill()
    parent.wait()
    wait_for(tmp_path / "notes", "saved")


def test_program_that_does_not_exist(tmp_path):
    with pytest.raises(OSError, match="no python"):
        run_here([str(tmp_path / "no python"), "script.py"], os.environ)
