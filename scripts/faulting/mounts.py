# SPDX-License-Identifier: GPL-3.0-or-later
"""File systems mounted for a case, where this user may mount any."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LEFT_OUT = "left out: this user may not mount file systems"


def can_mount() -> bool:
    """Return True on Linux, as root."""
    return sys.platform == "linux" and os.geteuid() == 0 and shutil.which("mount") is not None


@contextmanager
def mounted(*words: str, place: Path) -> Iterator[Path]:
    """Mount a file system at a new folder within the block.

    Args:
        *words: arguments of `mount`.
        place: folder to make.

    Raises:
        OSError: where it can't be mounted.
    """
    place.mkdir()
    done = subprocess.run(["mount", *words, str(place)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(done.stderr.strip())
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=True)


def remount(place: Path, options: str) -> None:
    """Change the options of a mounted file system.

    Args:
        place: folder where it is mounted.
        options: options of `mount`.
    """
    subprocess.run(["mount", "-o", f"remount,{options}", str(place)], check=True)
