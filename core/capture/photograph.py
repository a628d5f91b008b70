# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of a capture, and those that are left out with a reason."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Photograph:
    """Photograph that was read: an upright copy of it lies in the capture's folder.

    Attributes:
        name: unique name, also of the files made from it; valid as a file name on every system.
        source: file of the user, which is never changed; the video for a frame of a video.
        image: the upright copy, JPEG or PNG, sRGB.
        width, height: size of the copy in pixels.
        lens: key of the camera and its lens; photographs with the same key share their intrinsics.
        focal: focal length in pixels of the copy by EXIF, or None.
        exposure: exposure time x ISO / f-number^2 by EXIF, seconds; None where it is not stated.
        turned: quarter turns anticlockwise from the stored pixels to the copy (EXIF orientation), 0..3.
        mask: given mask, 8-bit PNG of the copy's size with 255 on the object, or None.
    """

    name: str
    source: Path
    image: Path
    width: int
    height: int
    lens: str
    focal: float | None = None
    exposure: float | None = None
    turned: int = 0
    mask: Path | None = None


@dataclass(frozen=True)
class LeftOut:
    """Photograph that is not used.

    Attributes:
        name: name of the file, or of the photograph.
        reason: reason in one line, such as "blurred: ...".
    """

    name: str
    reason: str
