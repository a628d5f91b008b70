# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a process of its own: torch and the kernels never enter Blender's."""

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
from ...core.machine.version import NEWER, VERSION
from ..user_folder import user_folder
from . import managed as managed_engine
from .child import detached
from .foreground import run_here
from .managed import LAUNCHER
from .preferences import DEFAULT_KIND, preferences

CHECK_SECONDS = 300.0  # the first import of torch from a slow disk takes long
HOW_TO_GET_ONE = "choose one under Edit > Preferences > Add-ons > IRGS++"


@dataclass(frozen=True)
class Status:
    """What is known of the engine.

    Attributes:
        state: "unknown" (not checked yet), "ok", "missing", "broken", or "version" (another version than this extension needs).
        text: one line for a person.
        devices: what `irgspp devices --json` said; empty where it wasn't asked.
    """

    state: str
    text: str
    devices: dict[str, Any] = field(default_factory=dict)

    @property
    def usable(self) -> bool:
        """True unless it is known not to work."""
        return self.state in ("ok", "unknown")


_known: dict[str, Status] = {}  # by the Python's path and time of change, what a check said


def engine_kind() -> str:
    """ "EXISTING", "MANAGED" or "INTERPRETER"; $IRGSPP_PYTHON makes it EXISTING."""
    if os.environ.get("IRGSPP_PYTHON"):
        return "EXISTING"
    chosen = preferences()
    return chosen.engine_kind if chosen is not None else DEFAULT_KIND


def engine_python() -> str:
    """The Python that runs the engine: $IRGSPP_PYTHON or what the preferences say; "" where they name none."""
    kind, chosen = engine_kind(), preferences()
    if kind == "INTERPRETER":
        return sys.executable
    if kind == "MANAGED":
        return str(managed_engine.python())
    named = os.environ.get("IRGSPP_PYTHON") or (bpy.path.abspath(chosen.engine_python) if chosen is not None else "")
    return str(_inside(Path(named))) if named else ""


def _inside(path: Path) -> Path:
    """A folder of a virtual environment stands for the Python in it."""
    return managed_engine.python_of(path) if path.is_dir() else path


def engine_command(*arguments: str) -> list[str]:
    """The command line that runs `irgspp ARGUMENTS` in the engine. Raises InputError where no engine is chosen."""
    python = engine_python()
    if not python:
        raise InputError("engine", "no Python is chosen", HOW_TO_GET_ONE)
    return [python, str(LAUNCHER), "__main__", *arguments]


def engine_environment() -> dict[str, str]:
    """The variables of the engine's processes: Blender's own Python must not show through, except where it is the engine."""
    kept = dict(os.environ)
    if engine_kind() != "INTERPRETER":
        for name in ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "__PYVENV_LAUNCHER__"):
            kept.pop(name, None)
        kept["PYTHONNOUSERSITE"] = "1"
    if bpy.app.binary_path:
        kept["IRGSPP_BLENDER"] = bpy.app.binary_path  # writes the .blend where the engine has no bpy
    return kept | {"PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1", "OMP_WAIT_POLICY": "PASSIVE"}


def keep_running() -> bool:
    """True where jobs shall go on after Blender has ended."""
    chosen = preferences()
    return bool(chosen is not None and chosen.keep_running)


def run_engine(arguments: Sequence[str]) -> int:
    """Run the command line (`irgspp ARGUMENTS`) to its end, on this process's terminal; its exit status."""
    found = status()
    if not found.usable:
        print(f"irgspp: {found.text}", file=sys.stderr)
        return 2
    try:
        return run_here(engine_command(*arguments), engine_environment())
    except OSError as error:
        print(f"irgspp: {engine_python()}: can't be started ({error.strerror}); {HOW_TO_GET_ONE}", file=sys.stderr)
        return 2


# --- whether it works


def status() -> Status:
    """What is known without starting anything; looks at the disk, so that an engine that was deleted is told at once."""
    kind, python = engine_kind(), engine_python()
    if not python:
        return Status("missing", f"No engine: {HOW_TO_GET_ONE}")
    if kind == "MANAGED":
        told = managed_engine.trouble()
        if told is not None:
            return Status(*told)
    try:
        key = _key(python)
    except OSError:
        return Status("missing", f"{python}: can't be started, as it does not exist; {HOW_TO_GET_ONE}")
    if key not in _known:
        _known.update(_remembered())
    return _known.get(key, Status("unknown", f"Not checked yet: {python}"))


def require_engine() -> None:
    """Raise InputError where the engine is known not to work."""
    found = status()
    if not found.usable:
        raise InputError("engine", found.text.removeprefix("No engine: "))


def check() -> Status:
    """Start the engine, ask what it is, remember the answer. Takes seconds: for scripts and background mode."""
    found = status()
    if found.state == "missing":
        return found
    try:
        done = subprocess.run(
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
    return remember(judged(done.returncode, done.stdout, done.stderr))


def judged(returned: int, output: str, errors: str) -> Status:
    """What the answer to `devices --json` says of an engine."""
    lines = [line.strip() for line in errors.splitlines() if line.strip()]
    last = lines[-1].removeprefix("irgspp: ") if lines else f"ended with status {returned}"
    if returned:
        return Status("version" if NEWER in last else "broken", f"The engine does not work: {last}")
    try:
        found = json.loads(output)
        version, python, cpu = found["irgspp"], found["python"], found["cpu"]["name"]
    except (ValueError, KeyError, TypeError):
        return Status("broken", "The engine does not work: it gave no answer that is understood")
    if version != VERSION:
        text = f"The engine is version {version}, this extension is {VERSION}: choose or install one of this version"
        return Status("version", text, found)
    cards = ", ".join(card["name"] for card in found["cuda"])
    return Status("ok", f"Engine {version} on Python {python}, {cards or cpu}", found)


def remember(found: Status) -> Status:
    """Keep what a check of the present engine said, on disk too."""
    try:
        _known[_key(engine_python())] = found
        kept = {key: asdict(value) for key, value in _known.items() if value.state == "ok"}
        (user_folder() / "engines.json").write_text(json.dumps(kept), encoding="utf-8")
    except OSError:
        return found  # it is asked again the next time
    return found


def forget_checks() -> None:
    """Check anew what was checked."""
    _known.clear()
    (user_folder() / "engines.json").unlink(missing_ok=True)


def _key(python: str) -> str:
    """Changes when another Python stands in the place, or the extension is another. Raises OSError where there is none."""
    return f"{python}|{os.stat(python).st_mtime_ns}|{VERSION}"


def _remembered() -> dict[str, Status]:
    try:
        kept = json.loads((user_folder() / "engines.json").read_text("utf-8"))
        return {key: Status(**value) for key, value in kept.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
