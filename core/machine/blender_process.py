# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender as a child process, for what only Blender can do: the engine can't share a process with it."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import Cancelled, InputError, IrgsppError
from .parent_watch import PARENT_WATCH

LAUNCHER = Path(__file__).resolve().parents[2] / "irgspp_addon" / "launch.py"
BLENDER = "IRGSPP_BLENDER"  # the environment variable that names a Blender executable; the extension sets it to the one it runs in


class NoBlender(IrgsppError):
    """No Blender was found that can be run."""


def blender_command() -> list[str]:
    """Return the command line that runs launch.py in Blender: the executable named by $IRGSPP_BLENDER, or this Python if it has bpy.

    The named executable has precedence, so that a .blend is written by the version that its user has.

    Raises:
        NoBlender: if there is neither.
    """
    named = os.environ.get(BLENDER, "")
    if named:
        executable = shutil.which(named)
        if executable is None:
            raise NoBlender(f"${BLENDER} names {named}, which is not a program; set it to Blender's executable")
        return [executable, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(LAUNCHER), "--"]
    if importlib.util.find_spec("bpy") is None:
        raise NoBlender(f"the Python module bpy is not installed, and ${BLENDER} is not set; set it to Blender's executable")
    return [sys.executable, str(LAUNCHER)]


def run_in_blender(module: str, arguments: Sequence[str], cancelled: Callable[[], bool]) -> tuple[int, str]:
    """Run a module of this package in Blender and wait until it ends.

    Args:
        module: name of the module below the package, such as "irgspp_addon.importer.write_blend".
        arguments: its command-line arguments.
        cancelled: asked five times a second; Blender is terminated once it returns True.

    Returns:
        Blender's exit status, and the last line that it wrote to stderr.

    Raises:
        Cancelled: if `cancelled` returned True.
        NoBlender: if there is no Blender.
    """
    command = [*blender_command(), module, *arguments]
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        # Its stdin ends with this process, however this ends: a Blender left behind would write to the same files as the next one.
        child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors, env={**os.environ, PARENT_WATCH: "1"}
        )
        try:
            status = _wait(child, cancelled)
        finally:
            assert child.stdin is not None
            child.stdin.close()
        errors.seek(0)
        lines = [line.strip() for line in errors if line.strip() and "not freed memory" not in line.lower()]
    return status, lines[-1] if lines else "no message"


def check_written(status: int, line: str, target: Path, written: Path) -> None:
    """Raise an error where a Blender process ended with a status or without its file.

    Args:
        status: exit status.
        line: last line of its errors.
        target: file that the user asked for.
        written: file that the process should have written.

    Raises:
        InputError: when it refused its input.
        IrgsppError: when it failed.
    """
    if status == InputError.exit_status:
        raise InputError(target, f"not written: {line}")
    if status or not written.is_file():
        raise IrgsppError(f"{target}: Blender ended with status {status}: {line}")


def _wait(child: subprocess.Popen, cancelled: Callable[[], bool]) -> int:
    while True:
        try:
            return child.wait(timeout=0.2)
        except subprocess.TimeoutExpired:
            if cancelled():
                child.terminate()
                child.wait()
                raise Cancelled("stopped while Blender was at work") from None
