# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture files shown in panels: loaded by Blender in the background, and again when they change."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews  # pyright: ignore[reportMissingImports]

LOOK_EVERY = 0.5  # seconds between looks at a file: a panel may draw sixty times in one

_previews: Any = None  # Blender's own collection of preview icons
_looked: dict[str, float] = {}  # when each file was looked at last
_written: dict[str, int] = {}  # when the image that is shown was written, in ns


def image(layout: bpy.types.UILayout, path: Path, scale: float = 8.0) -> bool:
    """Draw an image file, `scale` rows of buttons high; False where there is none (yet)."""
    key, now = str(path), time.monotonic()
    if _previews is None:
        return False
    if now - _looked.get(key, -LOOK_EVERY) >= LOOK_EVERY:
        _looked[key] = now
        _look(key)
    if key not in _previews:
        return False
    layout.template_icon(icon_value=_previews[key].icon_id, scale=scale)
    return True


def _look(key: str) -> None:
    """Load the file where it is new, again where it changed, and drop it where it is gone."""
    try:
        written = Path(key).stat().st_mtime_ns
    except OSError:  # not written yet, or deleted: nothing to show
        if key in _previews:
            del _previews[key]
        return
    if key not in _previews:
        _previews.load(key, key, "IMAGE")
    elif _written[key] != written:
        _previews[key].reload()
    _written[key] = written


def register() -> None:
    """Begin with no image."""
    global _previews
    _previews = bpy.utils.previews.new()


def unregister() -> None:
    """Give back the icons."""
    global _previews
    bpy.utils.previews.remove(_previews)
    _previews = None
    _looked.clear()
    _written.clear()
