# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender of its own for what only Blender can do: the engine can't share a process with one."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import Cancelled, IrgsppError
from .parent_watch import PARENT_WATCH

LAUNCHER = Path(__file__).resolve().parents[2] / "irgspp_addon" / "launch.py"
BLENDER = "IRGSPP_BLENDER"  # the environment variable that names a Blender executable; the extension sets it to the one it runs in


class NoBlender(IrgsppError):
    """There is no Blender to be run."""


def blender_command() -> list[str]:
    """What runs launch.py in a Blender: the executable that $IRGSPP_BLENDER names, or this Python where it has the module bpy.

    The named one goes first: a .blend is then of the version that its user has. Raises NoBlender where there is neither.
    """
    named = os.environ.get(BLENDER, "")
    if named:
        executable = shutil.which(named)
        if executable is None:
            raise NoBlender(f"${BLENDER} names {named}, which is no program")
        return [executable, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(LAUNCHER), "--"]
    if importlib.util.find_spec("bpy") is None:
        raise NoBlender(f"Blender's Python module (bpy) is not installed, and ${BLENDER} names no Blender")
    return [sys.executable, str(LAUNCHER)]


def run_in_blender(module: str, arguments: Sequence[str], cancelled: Callable[[], bool]) -> tuple[int, str]:
    """Run a module of this package in a Blender to its end; its exit status and the last line of what it said on stderr.

    Raises Cancelled (the Blender is ended), or NoBlender.
    """
    command = [*blender_command(), module, *arguments]
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        # Its stdin ends when this process does, however it does: then it must not go on writing beside the next one.
        child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors, env={**os.environ, PARENT_WATCH: "1"}
        )
        try:
            status = _wait(child, cancelled)
        finally:
            assert child.stdin is not None
            child.stdin.close()
        errors.seek(0)
        said = [line.strip() for line in errors if line.strip() and "not freed memory" not in line.lower()]
    return status, said[-1] if said else "no message"


def _wait(child: subprocess.Popen, cancelled: Callable[[], bool]) -> int:
    while True:
        try:
            return child.wait(timeout=0.2)
        except subprocess.TimeoutExpired:
            if cancelled():
                child.terminate()
                child.wait()
                raise Cancelled("stopped while Blender was at work") from None
