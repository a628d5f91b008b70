# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the files of a dataset may lie: a description from elsewhere must not lead anywhere else."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError


def inside(path: Path, root: Path) -> Path:
    """The path itself. Raises InputError where it leads out of the folder `root`, by "..", as an absolute path or through a link."""
    try:
        real, home = path.resolve(), root.resolve()
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, impossible names
        raise InputError(str(path)[:200], f"leads to an impossible file ({getattr(error, 'strerror', None) or error})") from error
    if not real.is_relative_to(home):
        raise InputError(path, f"leads out of the dataset's folder {root}", "copy what it names into that folder")
    return path


def plain_name(where: object, name: object) -> str:
    """The name of one folder or file. Raises InputError where it is none: with separators, empty, or a way up."""
    if not isinstance(name, str) or name in ("", ".", "..") or any(c in name for c in "/\\\0:"):
        raise InputError(where, f"{str(name)[:80]!r} is not the name of a folder")
    return name
