# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a separate process, so that torch and the kernels are never loaded into Blender: its Python, command line and status."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import bpy

from ...core.errors import InputError
from ...core.machine.version import OUTDATED, VERSION
from ..user_folder import user_folder
from . import managed
from .child import detached
from .foreground import run_here
from .managed import LAUNCHER
from .preferences import DEFAULT_KIND, PAGE, preferences

CHECK_SECONDS = 300.0  # the first import of torch from a slow disk takes long
HOW_TO_GET_ONE = f"choose one {PAGE}"


@dataclass(frozen=True)
class Status:
    """Status of the engine as far as it is known.

    Attributes:
        state: "unknown" (not checked yet), "ok", "missing", "broken", "version" (another version than this extension needs), or, in panels,
            "installing".
        text: one line for the user.
        devices: answer of `irgspp devices --json`; empty if the engine was not asked.
    """

    state: str
    text: str
    devices: dict[str, Any] = field(default_factory=dict)

    @property
    def usable(self) -> bool:
        """True unless the engine is known not to work."""
        return self.state in ("ok", "unknown")


_known: dict[str, Status] = {}  # results of checks, by the key of `_key`


def engine_kind() -> str:
    """Return the kind of the chosen engine: "EXISTING", "MANAGED" or "INTERPRETER"; it is "EXISTING" if $IRGSPP_PYTHON is set."""
    if os.environ.get("IRGSPP_PYTHON"):
        return "EXISTING"
    chosen = preferences()
    return chosen.engine_kind if chosen is not None else DEFAULT_KIND


def engine_python() -> str:
    """Return the Python that runs the engine, from $IRGSPP_PYTHON or the preferences; "" if neither names one."""
    kind, chosen = engine_kind(), preferences()
    if kind == "INTERPRETER":
        return sys.executable
    if kind == "MANAGED":
        return str(managed.python())
    named = os.environ.get("IRGSPP_PYTHON") or (bpy.path.abspath(chosen.engine_python) if chosen is not None else "")
    return str(_interpreter(Path(named))) if named else ""


def _interpreter(path: Path) -> Path:
    """Return the Python inside `path` if it is the folder of a virtual environment, otherwise `path` itself."""
    return managed.python_of(path) if path.is_dir() else path


def engine_command(*arguments: str) -> list[str]:
    """Return the command line that runs `irgspp ARGUMENTS` in the engine.

    Raises:
        InputError: if no engine is chosen.
    """
    python = engine_python()
    if not python:
        raise InputError("engine", "no Python is chosen", HOW_TO_GET_ONE)
    return [python, str(LAUNCHER), "__main__", *arguments]


def engine_environment() -> dict[str, str]:
    """Return the environment variables of the engine's processes, without those for Blender's Python unless that is the engine."""
    variables = dict(os.environ)
    if engine_kind() != "INTERPRETER":
        for name in ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "__PYVENV_LAUNCHER__"):
            variables.pop(name, None)
        variables["PYTHONNOUSERSITE"] = "1"
    if bpy.app.binary_path:
        variables["IRGSPP_BLENDER"] = bpy.app.binary_path  # writes the .blend if the engine has no bpy
    return variables | {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "OMP_WAIT_POLICY": "PASSIVE"}


def keep_running() -> bool:
    """Return True if jobs continue after Blender has ended."""
    chosen = preferences()
    return bool(chosen is not None and chosen.keep_running)


def run_engine(arguments: Sequence[str]) -> int:
    """Run `irgspp ARGUMENTS` in the foreground until it ends, and return its exit status."""
    engine = status()
    if not engine.usable:
        print(f"irgspp: {engine.text}", file=sys.stderr)
        return 2
    try:
        return run_here(engine_command(*arguments), engine_environment())
    except OSError as error:
        print(f"irgspp: {engine_python()}: can't be started ({error.strerror}); {HOW_TO_GET_ONE}", file=sys.stderr)
        return 2


# --- status


def status(place: str = PAGE) -> Status:
    """Return the engine's status without starting it; the files are looked up each time, so that a deleted engine is noticed at once.

    Args:
        place: where an engine is chosen and installed, for the text.
    """
    kind, python = engine_kind(), engine_python()
    if not python:
        return Status("missing", f"No engine: choose one {place}")
    if kind == "MANAGED":
        problem = managed.problem(place)
        if problem is not None:
            return Status(*problem)
    try:
        key = _key(python)
    except OSError:
        return Status("missing", f"{python}: can't be started, as it does not exist; choose one {place}")
    if key not in _known:
        _known.update(_remembered())
    return _known.get(key, Status("unknown", f"Not checked yet: {python}"))


def require_engine() -> None:
    """Check that the engine is not known to be unusable.

    Raises:
        InputError: if the engine is known not to work.
    """
    engine = status()
    if not engine.usable:
        raise InputError("engine", engine.text.removeprefix("No engine: "))


def check() -> Status:
    """Start the engine, ask for its version and devices, and remember the answer; it takes seconds, for scripts and background mode."""
    known = status()
    if known.state == "missing":
        return known
    try:
        answer = subprocess.run(
            engine_command("devices", "--json"),
            capture_output=True,
            text=True,
            errors="replace",
            env=engine_environment(),
            timeout=CHECK_SECONDS,
            check=False,
            **detached(),
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return remember(Status("broken", f"{engine_python()} can't be started ({error})"))
    return remember(check_result(answer.returncode, answer.stdout, answer.stderr))


def check_result(exit_status: int, output: str, errors: str) -> Status:
    """Return the status that follows from a run of `irgspp devices --json`.

    Args:
        exit_status: exit status of the process.
        output: text it wrote to stdout.
        errors: text it wrote to stderr.
    """
    lines = [line.strip() for line in errors.splitlines() if line.strip()]
    last = lines[-1].removeprefix("irgspp: ") if lines else f"ended with status {exit_status}"
    if exit_status:
        return Status("version" if OUTDATED in last else "broken", f"The engine does not work: {last}")
    try:
        devices = json.loads(output)
        version, python, cpu = devices["irgspp"], devices["python"], devices["cpu"]["name"]
    except (ValueError, KeyError, TypeError):
        return Status("broken", "The engine does not work: it gave no answer that this extension understands")
    if version != VERSION:
        text = f"The engine is version {version}, this extension is {VERSION}: choose or install an engine of version {VERSION}"
        return Status("version", text, devices)
    cards = ", ".join(card["name"] for card in devices["cuda"])
    return Status("ok", f"Engine {version} on Python {python}, {cards or cpu}", devices)


def remember(result: Status) -> Status:
    """Store the result of a check of the chosen engine, also on disk, and return it."""
    try:
        _known[_key(engine_python())] = result
        working = {key: asdict(value) for key, value in _known.items() if value.state == "ok"}
        (user_folder() / "engines.json").write_text(json.dumps(working), encoding="utf-8")
    except OSError:
        return result  # the engine is checked again the next time
    return result


def forget_checks() -> None:
    """Forget the results of all checks, in memory and on disk."""
    _known.clear()
    (user_folder() / "engines.json").unlink(missing_ok=True)


def _key(python: str) -> str:
    """Return a key that changes when the Python at this path is replaced or the extension has another version; OSError without a file."""
    return f"{python}|{os.stat(python).st_mtime_ns}|{VERSION}"


def _remembered() -> dict[str, Status]:
    """Read the results of earlier checks from disk."""
    try:
        stored = json.loads((user_folder() / "engines.json").read_text("utf-8"))
        return {key: Status(**value) for key, value in stored.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
