# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a process of its own: torch and the kernels never enter Blender's."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import bpy

from .preferences import EXTENSION

LAUNCHER = Path(__file__).with_name("launch.py")


def engine_python() -> str:
    """The Python that runs the engine: $IRGSPP_PYTHON, the preference, or Blender's own."""
    addon = bpy.context.preferences.addons.get(EXTENSION)
    chosen = addon.preferences.engine_python if addon else ""
    return os.environ.get("IRGSPP_PYTHON") or bpy.path.abspath(chosen) or sys.executable


def run_engine(arguments: Sequence[str]) -> int:
    """Run the command line (`irgspp ARGUMENTS`) to its end, on this process's terminal; its exit status."""
    command = [engine_python(), str(LAUNCHER), "__main__", *arguments]
    try:
        return subprocess.run(command, check=False).returncode
    except OSError as error:
        print(f"irgspp: {command[0]}: can't be started ({error.strerror}); set Engine Python in the preferences", file=sys.stderr)
        return 2
