# SPDX-License-Identifier: GPL-3.0-or-later
"""The folder that belongs to this extension on this machine; Blender's extensions must not write beside their code."""

from pathlib import Path

import bpy

EXTENSION = (__package__ or "").removesuffix(".irgspp_addon")


def user_folder(name: str = "") -> Path:
    """A folder of ours among the user's files, made where it is missing."""
    try:
        return Path(bpy.utils.extension_path_user(EXTENSION, path=name, create=True))
    except ValueError:  # imported as a plain package, not installed as an extension
        folder = Path(bpy.utils.user_resource("DATAFILES", path="irgspp", create=True)) / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder
