# SPDX-License-Identifier: GPL-3.0-or-later
"""Library of HDRIs to choose from by thumbnails: those that Blender ships for Material Preview, and those of the user's folder."""

# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews  # pyright: ignore[reportMissingImports]
from bpy.props import EnumProperty

from ...core.errors import IrgsppError
from ..engine.preferences import preferences
from .light_controls import SUFFIXES, use_hdri

CHECK_SECONDS = 2.0  # between two readings of the user's folder: a panel may be drawn sixty times a second
MOST = 400  # thumbnails at most

Items = list[tuple[str, str, str, int, int]]

_previews: Any = None  # Blender's collection of preview icons
_items: Items = []  # kept, because Blender keeps no references to the strings of its items
_read = -CHECK_SECONDS  # monotonic time at which the files were listed last


def library() -> list[Path]:
    """Return the files of the library: the user's first, then Blender's, each sorted by name."""
    page = preferences()
    folder = Path(bpy.path.abspath(page.hdri_folder)) if page is not None and page.hdri_folder else None
    try:
        own = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()] if folder is not None else []
    except OSError:  # the folder is gone or can't be read; the preferences show its path
        own = []
    shipped = [Path(light.path) for light in bpy.context.preferences.studio_lights if light.type == "WORLD"]
    files = [*sorted(own, key=_name), *sorted((file for file in shipped if file.is_file()), key=_name)]
    return list(dict.fromkeys(files))[:MOST]


def _name(file: Path) -> str:
    return file.name.lower()


def hdri_items(manager: bpy.types.WindowManager, context: bpy.types.Context | None) -> Items:
    """Return the items of the thumbnails: path, name, tooltip, icon and number.

    Args:
        manager: owner of the property, unused.
        context: unused.
    """
    global _read
    now = time.monotonic()
    if now - _read > CHECK_SECONDS:
        _read = now
        files = library()
        if [str(file) for file in files] != [item[0] for item in _items]:
            _items[:] = [(str(file), file.stem, f"Light the scene by {file}", _icon(file), i) for i, file in enumerate(files)]
    return _items


def _icon(file: Path) -> int:
    """Return the icon of a file's thumbnail, which Blender makes in the background."""
    if _previews is None:
        return 0
    if str(file) not in _previews:
        _previews.load(str(file), str(file), "IMAGE")
    return _previews[str(file)].icon_id


def _choose(manager: bpy.types.WindowManager, context: bpy.types.Context) -> None:
    """Light the scene by the chosen file; a damaged one is told in a pop-up."""
    try:
        use_hdri(context.scene, Path(manager.irgspp_hdri))
        context.scene.irgspp.use_world = True
    except (IrgsppError, RuntimeError) as error:  # the latter is Blender's, for a file that is no image
        _tell(manager, str(error).strip())
        return
    if not bpy.app.background:
        bpy.ops.ed.undo_push(message="HDRI")


def _tell(manager: bpy.types.WindowManager, text: str) -> None:
    """Show an error in a pop-up; without a window, for which Blender would crash, print it."""
    if bpy.app.background:
        print(f"irgspp: {text}", file=sys.stderr)
    else:
        manager.popup_menu(lambda menu, _: menu.layout.label(text=text), title="HDRI", icon="ERROR")


def register() -> None:
    """Add the property of the chosen thumbnail, and the collection of icons."""
    global _previews
    _previews = bpy.utils.previews.new()
    bpy.types.WindowManager.irgspp_hdri = EnumProperty(
        name="HDRI", description="Light the scene by an image of the surroundings", items=hdri_items, update=_choose, options={"SKIP_SAVE"}
    )


def unregister() -> None:
    """Remove the property and free the icons."""
    global _previews, _read
    del bpy.types.WindowManager.irgspp_hdri
    bpy.utils.previews.remove(_previews)
    _previews, _read = None, -CHECK_SECONDS
    _items.clear()
