# SPDX-License-Identifier: GPL-3.0-or-later
"""Cache folder for compiled kernels, writable by this user alone."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path


def cache_root() -> Path:
    """Return the user's cache folder for compiled kernels: $IRGSPP_CACHE if it is set, else the system's usual place."""
    if "IRGSPP_CACHE" in os.environ:
        return Path(os.environ["IRGSPP_CACHE"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "irgspp"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "irgspp"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "irgspp"


def _claim(folder: Path) -> None:
    """Create a folder that only this user can write to; whoever else could write to it could have this user run their code."""
    folder.mkdir(exist_ok=True, mode=0o700)
    about = folder.lstat()
    if hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & 0o022):
        raise PermissionError(f"{folder} belongs to another user or can be written by others")


def private_folder(name: str) -> Path:
    """Create and return a writable folder of that name in the cache folder, or else in the user's own folder of temporary files.

    Raises:
        OSError: if neither can be written.
    """
    fallback = Path(tempfile.gettempdir()) / f"irgspp-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
    for root in (cache_root(), fallback):
        try:
            if root == fallback:
                _claim(root)
            (root / name).mkdir(parents=True, exist_ok=True, mode=0o700)
            (root / name / ".writable").touch()
            return root / name
        except OSError:
            continue
    raise OSError("no writable folder for compiled kernels; set IRGSPP_CACHE to one")
