# SPDX-License-Identifier: GPL-3.0-or-later
"""Library of HDRIs to choose from by thumbnails: those that Blender ships for Material Preview, and those of the user's folder."""

# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews  # pyright: ignore[reportMissingImports]
from bpy.props import EnumProperty

from ...core.errors import IrgsppError
from ..engine.preferences import preferences
from ..windows import show_world
from .light_controls import SUFFIXES, light_controls, use_hdri

CHECK_SECONDS = 2.0  # between two readings of the user's folder: a panel may be drawn sixty times a second
MOST = 400  # thumbnails at most

Item = tuple[str, str, str, str | int, int]  # identifier, name, tooltip, icon and number of a choice
OTHER: Item = ("OTHER", "Choose", "The World shows no image of the surroundings", "WORLD", 0)

_previews: Any = None  # Blender's collection of preview icons
_items: dict[str, Item] = {}  # by path; kept, because Blender keeps no references to their strings
_files: list[Path] = []  # of the library
_read = -CHECK_SECONDS  # monotonic time at which the files were listed last


def library() -> list[Path]:
    """Return the files of the library: the user's first, then Blender's, each sorted by name."""
    folder = user_folder()
    try:
        own = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()] if folder is not None else []
    except OSError:
        own = []  # the panel says that the folder can't be read, see `unreadable_folder`
    shipped = [Path(light.path) for light in bpy.context.preferences.studio_lights if light.type == "WORLD"]
    files = [*sorted(own, key=_name), *sorted((file for file in shipped if file.is_file()), key=_name)]
    return list(dict.fromkeys(files))[:MOST]


def user_folder() -> Path | None:
    """Return the user's folder of HDRIs; None where the preferences name none."""
    page = preferences()
    return Path(bpy.path.abspath(page.hdri_folder)) if page is not None and page.hdri_folder else None


def unreadable_folder() -> Path | None:
    """Return the user's folder of HDRIs where it is not there, else None."""
    folder = user_folder()
    return folder if folder is not None and not folder.is_dir() else None


def _name(file: Path) -> str:
    return file.name.lower()


def shown_hdri(scene: bpy.types.Scene) -> Path | None:
    """Return the file of the image that the scene's World shows; None for other Worlds."""
    image = light_controls(scene.world).image
    if image is None or not image.filepath:
        return None
    file = Path(os.path.normpath(bpy.path.abspath(image.filepath, library=image.library)))
    return file if file.is_file() else None


def hdri_items(scene: bpy.types.Scene, context: bpy.types.Context | None) -> list[Item]:
    """Return the thumbnails to choose from: the library, preceded by what the World shows if it is not in there.

    Args:
        scene: scene with the World.
        context: unused.
    """
    global _read
    now = time.monotonic()
    if now - _read > CHECK_SECONDS:
        _read, _files[:] = now, library()
    items, shown = [_item(file) for file in _files], _shown_item(scene)
    return items if shown in items else [shown, *items]


def _item(file: Path, name: str = "") -> Item:
    """Return the choice of a file, whose number stays its own when others come or go.

    Args:
        file: image of the surroundings.
        name: shown below the thumbnail; "": that of the file.
    """
    path = str(file)
    if path not in _items:
        _items[path] = (path, name or file.stem, f"Light the scene by {path}", _icon(path), len(_items) + 1)
    return _items[path]


def _icon(path: str) -> int:
    """Return the icon of a file's thumbnail, which Blender makes in the background."""
    return 0 if _previews is None else _previews.load(path, path, "IMAGE").icon_id


def _shown_item(scene: bpy.types.Scene) -> Item:
    """Return the choice that the World shows."""
    file = shown_hdri(scene)
    return OTHER if file is None else _item(file, "" if file in _files else scene.world.name)


def _shown_number(scene: bpy.types.Scene) -> int:
    return _shown_item(scene)[4]


def _choose(scene: bpy.types.Scene, number: int) -> None:
    """Light the scene by a choice; a damaged file is told in a pop-up."""
    path = next((path for path, *_, own in _items.values() if own == number), None)
    if path is None or number == _shown_number(scene):
        return
    try:
        use_hdri(scene, Path(path))
        scene.irgspp.use_world = True
        show_world(scene)
    except (IrgsppError, RuntimeError) as error:  # the latter is Blender's, for a file that is no image
        _tell(str(error).strip())


def _tell(text: str) -> None:
    """Show an error in a pop-up; without a window, for which Blender would crash, print it."""
    if bpy.app.background:
        print(f"irgspp: {text}", file=sys.stderr)
    else:
        bpy.context.window_manager.popup_menu(lambda menu, _: menu.layout.label(text=text), title="HDRI", icon="ERROR")


def register() -> None:
    """Add the property of the chosen thumbnail, which stores nothing: it reads and changes the World."""
    global _previews
    _previews = bpy.utils.previews.new()
    bpy.types.Scene.irgspp_hdri = EnumProperty(
        name="HDRI", description="Light the scene by an image of the surroundings", items=hdri_items, get=_shown_number, set=_choose
    )


def unregister() -> None:
    """Remove the property and free the icons."""
    global _previews, _read
    del bpy.types.Scene.irgspp_hdri
    bpy.utils.previews.remove(_previews)
    _previews, _read = None, -CHECK_SECONDS
    _items.clear()
    _files.clear()
