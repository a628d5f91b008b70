# SPDX-License-Identifier: GPL-3.0-or-later
"""Child processes: apart from Blender's terminal, and how they ended."""

from __future__ import annotations

import signal
import subprocess
import sys
from typing import Any


def detached() -> dict[str, Any]:
    """Options of Popen for a process that has no window, and that Ctrl-C in Blender's terminal, or its end, does not reach."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def ended_by(number: int) -> str:
    """How the engine's process ended that a signal killed, in words."""
    name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
    return f"the engine was ended by {name}{', as when memory runs out' if name == 'SIGKILL' else ''}"
