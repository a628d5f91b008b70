# SPDX-License-Identifier: GPL-3.0-or-later
"""Managed engine: the Python environment that the extension installs in its folder for user files."""

from __future__ import annotations

import hashlib
import json
import secrets
import subprocess
import sys
from pathlib import Path

from ...core.errors import InputError, IrgsppError
from ..user_folder import user_folder
from . import install
from .child import detached
from .install import MARKER, python_of
from .preferences import PAGE

ROOT = Path(__file__).resolve().parents[2]
LOCK, HASHES, PROJECT = ROOT / "requirements.lock", ROOT / "requirements.sha256", ROOT / "pyproject.toml"
LAUNCHER = ROOT / "irgspp_addon" / "launch.py"
INSTALLER = Path(install.__file__)
DELETE = "import shutil, sys; shutil.rmtree(sys.argv[1], ignore_errors=True)"


def folder() -> Path:
    """Return the folder of the managed engine, whether it is installed or not."""
    return user_folder() / "engine"


def python() -> Path:
    """Return the path of the managed engine's Python."""
    return python_of(folder())


def is_installed() -> bool:
    """Return True where this extension has installed an engine, whether it can be used or not."""
    return folder().exists()


def problem(place: str = PAGE) -> tuple[str, str] | None:
    """Return why the managed engine can't be used, as state ("missing" or "version") and one line of text; None if it can be used.

    Args:
        place: where an engine is installed, for the text.
    """
    if not is_installed():
        return "missing", f"No engine: install one {place}, or choose an environment that has it"
    if not python().exists():  # a link to a Python that was removed, such as with an older Blender
        return "missing", f"The installed engine can't be started, as the Python that it was made with is gone: install it again {place}"
    if marker().get("lock") != lock_digest():
        return "version", f"The installed engine belongs to another version of this extension: install it again {place}"
    return None


def marker() -> dict:
    """Return the record that a complete installation leaves (keys lock, device and python); empty without one."""
    try:
        record = json.loads((folder() / MARKER).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}


def lock_digest() -> str:
    """Return the SHA-256 of the lock file, which identifies the locked versions."""
    return hashlib.sha256(LOCK.read_bytes()).hexdigest()


def install_arguments(device: str, wheels: Path | None, index: str, online: bool) -> list[str]:
    """Return the command-line arguments of the installer.

    Args:
        device: "cpu" or "cuda".
        wheels: folder of wheels to install from; None downloads them.
        index: address of an additional package index; "" uses pip's default index alone.
        online: True if Blender allows extensions to use the network.

    Raises:
        InputError: if the device is unknown, the folder holds no wheels, or there is neither a folder nor permission to use the network.
    """
    if device not in ("cpu", "cuda"):
        raise InputError(device, "is not a known device", "use cpu or cuda")
    if wheels is None and not online:
        fix = "allow it under Preferences > System > Network, or choose a folder of wheels"
        raise InputError("install engine", "Blender may not use the network", fix)
    if wheels is not None and not (wheels.is_dir() and any(wheels.glob("*.whl"))):
        raise InputError(wheels, "is not a folder with wheels (*.whl)")
    arguments = [*map(str, (folder(), LOCK, HASHES, PROJECT, LAUNCHER)), "--device", device]
    arguments += ["--wheels", str(wheels)] if wheels is not None else []
    return arguments + (["--index", index] if index else [])


def remove() -> None:
    """Remove the managed engine: rename its folder, and delete it in another process, since it holds tens of thousands of files.

    Raises:
        InputError: if no engine is installed.
        IrgsppError: if the folder can't be renamed, such as while a program uses it on Windows.
    """
    installed = folder()
    if not is_installed():
        raise InputError(installed, "there is no engine to remove")
    removed = installed.with_name(f"engine.removed-{secrets.token_hex(4)}")
    try:
        installed.rename(removed)
    except OSError as error:
        raise IrgsppError(f"{installed}: can't be removed ({error.strerror}); close the programs that use it") from error
    subprocess.Popen([sys.executable, "-I", "-c", DELETE, str(removed)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, **detached())
