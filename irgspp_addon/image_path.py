# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of linked images: relative to the .blend file where it has been saved, so that a project can be moved as a whole."""

from __future__ import annotations

from pathlib import Path

import bpy


def path_in_file(path: Path) -> str:
    """Return a path as images of the open file store it: relative to it (`//...`); absolute in a file that has never been saved.

    Blender itself makes absolute paths relative only when a file is saved for the first time.

    Args:
        path: file of an image.
    """
    if not bpy.data.filepath:
        return str(path.resolve())
    try:
        return bpy.path.relpath(str(path.resolve()))
    except ValueError:  # another drive of Windows
        return str(path.resolve())
