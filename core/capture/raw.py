# SPDX-License-Identifier: GPL-3.0-or-later
"""RAW photographs: demosaicing to linear light, encoded as sRGB."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import rawpy
from PIL import Image

from ..errors import InputError
from ..io.exr import check_filled, check_pixels
from ..io.srgb import encode_srgb
from .exif import EXIF_IFD, EXPOSURE_TIME, F_NUMBER, FOCAL, ISO, Orientation, Shot, shot_of

TURNS = {0: 0, 3: 2, 5: 1, 6: 3}  # quarter turns anticlockwise by LibRaw's flip
MAX_PIXELS_PER_BYTE = 64  # largest number of pixels in a byte of a RAW file: even lossy ones have a bit for every few pixels


def decode_raw(path: Path) -> tuple[np.ndarray, Shot]:
    """Decode a RAW photograph with the camera's white balance and no automatic brightness, so that EXIF's exposure stays true.

    Args:
        path: the file.

    Returns:
        (H, W, 3) uint16 sRGB as stored, highlights clipped, and the EXIF.

    Raises:
        InputError: if the file can't be decoded.
    """
    try:
        with rawpy.imread(str(path)) as raw:
            sizes = raw.sizes
            check_pixels(path, sizes.raw_width, sizes.raw_height)
            check_filled(path, sizes.raw_width * sizes.raw_height, MAX_PIXELS_PER_BYTE * path.stat().st_size)
            shot = _shot(path, raw)
            linear = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                adjust_maximum_thr=0,  # else the white level depends on the image
                use_camera_wb=True,
                output_bps=16,
                output_color=rawpy.ColorSpace.sRGB,  # pyright: ignore[reportAttributeAccessIssue]
                user_flip=0,
            )
    except InputError:
        raise
    except Exception as error:  # LibRaw's errors are plain exceptions of several kinds
        raise InputError(
            path, f"not a readable RAW photograph ({str(error)[:120] or type(error).__name__})", "develop it to a JPEG"
        ) from error
    return _curve()[linear], shot


def _shot(path: Path, raw: rawpy.RawPy) -> Shot:
    """Read the EXIF of a RAW file that is a TIFF inside, else what LibRaw tells."""
    sizes, other = raw.sizes, raw.other
    known = {EXPOSURE_TIME: other.shutter_speed, F_NUMBER: other.aperture, ISO: other.iso_speed, FOCAL: other.focal_length}
    shot = shot_of({t: v for t, v in known.items() if v} | _tags(path), sizes.width, sizes.height)
    return replace(shot, orientation=Orientation(TURNS.get(sizes.flip, 0)))


def _tags(path: Path) -> dict:
    """Return the EXIF tags of a file that begins like a TIFF; none for others and damaged ones."""
    try:
        with path.open("rb") as file:
            exif = Image.Exif()
            exif.load_from_fp(file)
            return {**exif, **exif.get_ifd(EXIF_IFD)}
    except Exception:  # see exif.read_shot; LibRaw's own values are used
        return {}


@functools.cache
def _curve() -> np.ndarray:
    """Return the sRGB curve as a table from linear uint16 to encoded uint16."""
    return np.round(65535 * encode_srgb(np.arange(65536) / 65535)).astype(np.uint16)
