# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenEXR images as named float channels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR

from ..errors import InputError
from .atomic import atomic_file

MAX_PIXELS = 178_000_000  # beyond any camera (Pillow's own limit): a header that claims more is damaged or hostile
RATIO = 4000  # largest number of pixels that a byte of an EXR can encode
SLACK = 1 << 16


def exr_size(path: Path) -> tuple[int, int]:
    """Return (width, height) in pixels from the header alone.

    Raises:
        InputError: if the header can't be read, or claims more pixels than MAX_PIXELS or than the file can hold.
    """
    try:
        low, high = OpenEXR.File(str(path), header_only=True).header()["dataWindow"]
        width, height = int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1
    except Exception as error:  # the library raises plain RuntimeError and TypeError for broken files
        raise InputError(path, f"not a readable EXR image ({error})") from error
    check_pixels(path, width, height)
    check_filled(path, width * height, RATIO * path.stat().st_size)
    return width, height


def check_pixels(path: Path, width: int, height: int) -> None:
    """Check the number of pixels that an image's header claims.

    Args:
        path: the image, for the message.
        width: in pixels.
        height: in pixels.

    Raises:
        InputError: if there are more than MAX_PIXELS.
    """
    if width * height > MAX_PIXELS:
        raise InputError(path, f"claims {width}x{height} pixels, more than the {MAX_PIXELS // 10**6} million allowed")


def check_filled(path: Path, claimed: int, possible: int) -> None:
    """Check what an image's header claims against the size of its file, since decoders allocate memory for all of it first.

    Args:
        path: the image, for the message.
        claimed: number of pixels (or bytes) that the header claims.
        possible: largest number of them that a file of this size can hold.

    Raises:
        InputError: if more is claimed than possible.
    """
    if claimed > possible + SLACK:
        raise InputError(path, "claims far more pixels than a file of its size can hold: it is damaged or malicious")


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Read the channels of a single-part EXR by name, each (H, W) float32.

    Raises:
        InputError: if the file can't be read, or claims more pixels than allowed.
    """
    exr_size(path)
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return {name: np.asarray(c.pixels, np.float32) for name, c in file.channels().items()}
    except Exception as error:  # the library raises plain RuntimeError and TypeError for broken files
        raise InputError(path, f"not a readable EXR image ({error})") from error


def read_exr_rgb(path: Path) -> np.ndarray:
    """Read the colour (H, W, 3) float32 of an EXR; a grey image (Y, or a single channel) is repeated.

    Raises:
        InputError: if the file can't be read, or has neither R, G, B nor a grey channel.
    """
    channels = read_exr(path)
    if {"R", "G", "B"} <= channels.keys():
        return np.stack([channels["R"], channels["G"], channels["B"]], -1)
    if len(channels) == 1 or "Y" in channels:
        return np.repeat(channels.get("Y", next(iter(channels.values())))[..., None], 3, -1)
    raise InputError(path, f"has channels {', '.join(channels)} but not R, G, B")


def write_exr(path: Path, channels: dict[str, np.ndarray], half: bool = False) -> None:
    """Write an EXR atomically, ZIP-compressed.

    Args:
        path: the file to write.
        channels: channel name -> (H, W) array.
        half: store 16-bit instead of 32-bit floats.
    """
    pixels = {name: np.ascontiguousarray(c, np.float16 if half else np.float32) for name, c in channels.items()}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with atomic_file(path) as partial, OpenEXR.File(header, pixels) as file:
        file.write(str(partial))


def rgb_channels(image: np.ndarray) -> dict[str, np.ndarray]:
    """Split an image (H, W, 3) or (H, W, 4) into channels R, G, B and A, each (H, W)."""
    return {name: image[..., i] for i, name in enumerate("RGBA"[: image.shape[-1]])}
