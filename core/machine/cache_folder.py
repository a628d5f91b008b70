# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's folder for compiled kernels: writable by this user alone."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path


def cache_root() -> Path:
    """The user's cache folder for compiled kernels ($IRGSPP_CACHE wins)."""
    if "IRGSPP_CACHE" in os.environ:
        return Path(os.environ["IRGSPP_CACHE"])
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "irgspp"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "irgspp"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "irgspp"


def _claim(folder: Path) -> None:
    """Make a folder that only this user can write to; compiled code out of somebody else's would be theirs to choose."""
    folder.mkdir(exist_ok=True, mode=0o700)
    about = folder.lstat()
    if hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & 0o022):
        raise PermissionError(f"{folder} is open to others")


def private_folder(name: str) -> Path:
    """A writable folder of that name in the cache, or else in one of the user's own among the temporary files."""
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
