# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's relight preview, as stories see it: its state, its pixels, and waiting for it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
import driver
import numpy as np


def follower() -> Any:
    """Return the follower of the preview, which keeps it up to date."""
    live_image, preview = (driver.extension_module(f"irgspp_addon.relight.{name}") for name in ("live_image", "preview"))
    return live_image.follower_of(preview.CHANNEL)


def finished(timeout: float = 180.0) -> Iterator[float]:
    """Wait until the preview is finished, and check that it did not fail.

    Args:
        timeout: seconds.
    """
    yield from driver.wait(lambda: follower().done or follower().failed, timeout)
    assert not follower().failed, follower().message


def updated(before: np.ndarray | None = None) -> Iterator[float]:
    """Wait until the preview has followed a change.

    Args:
        before: the preview's pixels before the change; None where it may have followed already.
    """
    if before is not None:  # an update can be over before this looks at it
        yield from driver.wait(lambda: not np.array_equal(pixels(), before), 60, step=0.1)
    shown = np.empty(0)
    while not np.array_equal(pixels(), shown):  # a change that was just made is not noticed at once
        yield from finished()
        shown = pixels()
        yield 1.5


def pixels() -> np.ndarray:
    """Return the preview's pixels (H, W, 4)."""
    image = bpy.data.images[driver.extension_module("irgspp_addon.relight.preview").IMAGE]
    width, height = image.size
    values = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, 4)
