# SPDX-License-Identifier: GPL-3.0-or-later
"""Image files in panels: loaded by Blender in the background, and again when they change."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews  # pyright: ignore[reportMissingImports]

CHECK_SECONDS = 0.5  # between two checks of a file: a panel may be drawn sixty times a second

_previews: Any = None  # Blender's collection of preview icons
_checked: dict[str, float] = {}  # when each file was checked last, seconds on the monotonic clock
_written: dict[str, int] = {}  # modification time of the image that is shown, ns


def image(layout: bpy.types.UILayout, path: Path, scale: float = 8.0) -> bool:
    """Draw an image file; return False where there is none (yet).

    Args:
        layout: to draw into.
        path: image file.
        scale: height in rows of buttons.
    """
    key, now = str(path), time.monotonic()
    if _previews is None:
        return False
    if now - _checked.get(key, -CHECK_SECONDS) >= CHECK_SECONDS:
        _checked[key] = now
        _check(key)
    if key not in _previews:
        return False
    layout.template_icon(icon_value=_previews[key].icon_id, scale=scale)
    return True


def _check(key: str) -> None:
    """Load a new file, reload a changed one, and forget one that is gone."""
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
    """Make the empty collection of icons."""
    global _previews
    _previews = bpy.utils.previews.new()


def unregister() -> None:
    """Free the icons."""
    global _previews
    bpy.utils.previews.remove(_previews)
    _previews = None
    _checked.clear()
    _written.clear()
