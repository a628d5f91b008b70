# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of the split view: what the window shows left of the border is the photograph, in its own colours."""

from __future__ import annotations

from pathlib import Path

import bpy
import driver
import numpy as np

COLOUR_ERROR = 0.02  # mean absolute difference of the shown photograph, sRGB 0..1
EDGE = 24  # pixels left out at the frame's edges, and above its lower edge for the words


def check_left_half(screen: Path) -> None:
    """Compare the left half of the camera's frame in a screenshot with the left half of the photograph, where this is opaque.

    Args:
        screen: screenshot of the whole window with the border in the middle.
    """
    split = driver.extension_module("irgspp_addon.comparison.split")
    photograph = driver.extension_module("irgspp_addon.comparison.photograph").shown_photograph(bpy.context.scene).image
    place = driver.region("WINDOW")
    left, bottom, right, top = split.camera_rectangle(bpy.context.scene, place, driver.view3d().spaces[0].region_3d)
    x, y = np.arange(int(left) + EDGE, int((left + right) / 2) - EDGE), np.arange(int(bottom) + 2 * EDGE, int(top) - EDGE)
    shown = pixels(bpy.data.images.load(str(screen)))[np.ix_(y + place.y, x + place.x)]
    original = pixels(photograph)
    height, width = original.shape[:2]
    rows, columns = (y + 0.5 - bottom) / (top - bottom) * height, (x + 0.5 - left) / (right - left) * width
    expected = original[np.ix_(rows.astype(int), columns.astype(int))]
    opaque = expected[..., 3] > 0.99
    error = float(np.abs(shown - expected)[..., :3][opaque].mean())
    print(f"split view: mean colour error {error:.4f} over {opaque.sum()} pixels")
    assert opaque.any() and error < COLOUR_ERROR, f"the photograph is shown in other colours: {error:.3f}"


def pixels(image: bpy.types.Image) -> np.ndarray:
    """Return the pixels (H, W, 4) of an 8-bit image, bottom row first, in its own colour space."""
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)
