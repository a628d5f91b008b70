# SPDX-License-Identifier: GPL-3.0-or-later
"""Folder for the extension's own files: Blender's extensions must not write next to their code."""

from pathlib import Path

import bpy

EXTENSION = (__package__ or "").removesuffix(".irgspp_addon")


def user_folder(name: str = "") -> Path:
    """Return the extension's folder for user files, or its subfolder `name`; it is created if it does not exist."""
    try:
        return Path(bpy.utils.extension_path_user(EXTENSION, path=name, create=True))
    except ValueError:  # imported as a plain package, not installed as an extension
        folder = Path(bpy.utils.user_resource("DATAFILES", path="irgspp", create=True)) / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder
