# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's windows: finding and redrawing their areas, and resizing images for display."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np


def areas(*kinds: str) -> Iterator[bpy.types.Area]:
    """Yield the areas of these types (such as "VIEW_3D") in all windows; none in background mode."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager else ():
        yield from (area for area in window.screen.areas if area.type in kinds)


def redraw(*kinds: str) -> None:
    """Redraw all areas of these types."""
    for area in areas(*kinds):
        area.tag_redraw()


def enlarged(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Resize an image by nearest neighbour and return its pixels in Blender's order.

    Args:
        image: (H, W, 4) pixels, top row first.
        width: width of the result in pixels.
        height: height of the result in pixels.

    Returns:
        (height * width * 4,) float32, bottom row first.
    """
    rows = np.arange(height - 1, -1, -1) * len(image) // height
    columns = np.arange(width) * image.shape[1] // width
    return np.ascontiguousarray(image[rows][:, columns], np.float32).reshape(-1)
