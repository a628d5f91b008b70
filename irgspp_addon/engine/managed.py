# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine that this extension installs for itself: a Python environment in the user's folder of the extension."""

from __future__ import annotations

import hashlib
import json
import secrets
import subprocess
import sys
from pathlib import Path

from ...core.errors import InputError, IrgsppError
from ..user_folder import user_folder
from . import install as install_engine
from .child import detached
from .install import MARKER, python_of

ROOT = Path(__file__).resolve().parents[2]
LOCK, HASHES, PROJECT = ROOT / "requirements.lock", ROOT / "requirements.sha256", ROOT / "pyproject.toml"
LAUNCHER = ROOT / "irgspp_addon" / "launch.py"
INSTALLER = Path(install_engine.__file__)
DELETE = "import shutil, sys; shutil.rmtree(sys.argv[1], ignore_errors=True)"


def folder() -> Path:
    """Where it is, or would be."""
    return user_folder() / "engine"


def python() -> Path:
    """Its Python."""
    return python_of(folder())


def trouble() -> tuple[str, str] | None:
    """State and text where it can't be used: ("missing" or "version", one line); None where it can."""
    if not python().exists():
        return "missing", "No engine: install one under Edit > Preferences > Add-ons > IRGS++, or choose an environment that has it"
    if marker().get("lock") != lock_digest():
        return "version", "The installed engine is that of another version of this extension: install it again in the preferences"
    return None


def marker() -> dict:
    """What the installation noted when it was complete: lock, device, python, irgspp. Empty where it is not."""
    try:
        noted = json.loads((folder() / MARKER).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return noted if isinstance(noted, dict) else {}


def lock_digest() -> str:
    """Identifies the locked versions."""
    return hashlib.sha256(LOCK.read_bytes()).hexdigest()


def install_arguments(device: str, wheels: Path | None, index: str, online: bool) -> list[str]:
    """Arguments for the installer. Raises InputError where it may not use the network and has no folder of wheels."""
    if device not in ("cpu", "cuda"):
        raise InputError(device, "is no device", "use cpu or cuda")
    if wheels is None and not online:
        fix = "allow it under Preferences > System > Network, or name a folder of wheels"
        raise InputError("install engine", "Blender may not use the network", fix)
    if wheels is not None and not (wheels.is_dir() and any(wheels.glob("*.whl"))):
        raise InputError(wheels, "is not a folder with wheels (*.whl)")
    words = [*map(str, (folder(), LOCK, HASHES, PROJECT, LAUNCHER)), "--device", device]
    words += ["--wheels", str(wheels)] if wheels is not None else []
    return words + (["--index", index] if index else [])


def remove() -> None:
    """Delete it: out of the way at once, from the disk by another process, as there are tens of thousands of files."""
    place = folder()
    if not place.exists():
        raise InputError(place, "there is no engine to remove")
    doomed = place.with_name(f"engine.removed-{secrets.token_hex(4)}")
    try:
        place.rename(doomed)
    except OSError as error:
        raise IrgsppError(f"{place}: can't be removed ({error.strerror}); end the programs that use it") from error
    subprocess.Popen([sys.executable, "-I", "-c", DELETE, str(doomed)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, **detached())
