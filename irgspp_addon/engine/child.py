# SPDX-License-Identifier: GPL-3.0-or-later
"""Child processes: options to detach them from Blender's terminal, and descriptions of how they ended."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import Any


def detached() -> dict[str, Any]:
    """Return options for Popen that start a process without a window, unaffected by Ctrl-C in, or the end of, Blender's terminal."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def ended_by(number: int) -> str:
    """Describe the end of an engine process that was killed by the signal of this number."""
    name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
    return f"the engine was ended by {name}{', as when memory runs out' if name == 'SIGKILL' else ''}"
