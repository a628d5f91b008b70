# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the files of a dataset may lie: a description from elsewhere must not lead anywhere else."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import InputError

IMPOSSIBLE = re.compile(r'[<>:"/\\|?*\x00-\x1f\x7f]')  # in names of files, on one system or another; a colon leads to other places
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # devices of Windows
LONGEST = 120  # bytes of a name; file systems allow 255, of which suffixes and numbers take some


def inside(path: Path, root: Path) -> Path:
    """The path itself. Raises InputError where it leads out of the folder `root`, by "..", as an absolute path or through a link."""
    try:
        real, home = path.resolve(), root.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, impossible names
        raise InputError(str(path)[:200], f"leads to an impossible file ({getattr(error, 'strerror', None) or error})") from error
    if not real.is_relative_to(home):
        what = f"leads out of the dataset's folder {root}, to {real}"
        raise InputError(path, what, "copy what is there into that folder; a link is followed to the whole dataset alone")
    return path


def is_file(path: Path) -> bool:
    """True where there is such a file; False also for names that no file can have, as too long ones."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def plain_name(where: object, name: object) -> str:
    """The name of one folder or file. Raises InputError where it is none: with separators, empty, or a way up."""
    if not isinstance(name, str) or name in ("", ".", "..") or any(c in name for c in "/\\\0:"):
        raise InputError(where, f"{str(name)[:80]!r} is not the name of a folder")
    return name


def possible_name(name: str) -> str:
    """The name as one that every file system takes: what can't stand in it becomes _, the end of a long one is left out."""
    name = IMPOSSIBLE.sub("_", name.encode(errors="replace").decode())
    name = name.encode()[:LONGEST].decode(errors="ignore").strip(" .")
    return f"_{name}" if RESERVED.fullmatch(name) or not name else name
