# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of paths and file names from untrusted descriptions: they must not lead out of the dataset's folder."""

from __future__ import annotations

import re
from pathlib import Path

from ..errors import InputError

IMPOSSIBLE = re.compile(r'[<>:"/\\|?*\x00-\x1f\x7f]')  # not allowed in file names on some system; a colon names a drive or a stream
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)  # devices of Windows
LONGEST = 120  # bytes of a name; file systems allow 255, including suffixes and numbers


def inside(path: Path, root: Path) -> Path:
    """Check that a path lies inside a folder, and return it.

    Args:
        path: the path to check.
        root: the folder that must contain it.

    Raises:
        InputError: if it leads out of the folder, by "..", as an absolute path or through a link, or is impossible.
    """
    try:
        real, home = path.resolve(), root.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # circular links, impossible names
        raise InputError(str(path)[:200], f"leads to an impossible file ({getattr(error, 'strerror', None) or error})") from error
    if not real.is_relative_to(home):
        what = f"leads out of the dataset's folder {root}, to {real}"
        raise InputError(path, what, "copy the file into that folder; only a link to the whole dataset is followed")
    return path


def is_file(path: Path) -> bool:
    """Return True if the file exists; False also for names that no file can have, such as one that is too long."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def plain_name(where: object, name: object) -> str:
    """Check that a value is the name of a single folder or file, and return it.

    Args:
        where: where the value stands, for the message.
        name: the value.

    Raises:
        InputError: if it is not a string, is empty, "." or "..", or has separators.
    """
    if not isinstance(name, str) or name in ("", ".", "..") or any(c in name for c in "/\\\0:"):
        raise InputError(where, f"{str(name)[:80]!r} is not the name of a folder")
    return name


def possible_name(name: str) -> str:
    """Convert a name to one that every file system accepts: impossible characters become _, and a long name is cut off."""
    name = IMPOSSIBLE.sub("_", name.encode(errors="replace").decode())
    name = name.encode()[:LONGEST].decode(errors="ignore").strip(" .")
    return f"_{name}" if RESERVED.fullmatch(name) or not name else name
