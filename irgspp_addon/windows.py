# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's windows: their areas, and images as they show them."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np


def areas(*kinds: str) -> Iterator[bpy.types.Area]:
    """The areas of these kinds in all windows; none in background mode."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        yield from (area for area in window.screen.areas if area.type in kinds)


def redraw(*kinds: str) -> None:
    """Draw areas of these kinds anew."""
    for area in areas(*kinds):
        area.tag_redraw()


def enlarged(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Pixels of an image (H, W, 4) with the top row first, one after the other as Blender wants them: from the bottom, in this size."""
    rows = np.arange(height - 1, -1, -1) * len(image) // height
    columns = np.arange(width) * image.shape[1] // width
    return np.ascontiguousarray(image[rows][:, columns], np.float32).reshape(-1)
