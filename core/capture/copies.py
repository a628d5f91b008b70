# SPDX-License-Identifier: GPL-3.0-or-later
"""Upright copies of photographs in a capture's folder, and the record by which a later reading takes them as they are."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from ..errors import InputError
from ..io.atomic import write_atomic
from .decoding import DecodedPhotograph, decode_photograph
from .exif import Orientation, lens_key
from .given_masks import write_mask
from .photograph import Photograph
from .photograph_files import COPIES, GIVEN_MASKS, RECORD

VERSION = 1  # of the record; another one is made again
QUALITY = 95  # of JPEG copies
COMPRESSION = 3  # of PNG copies, 0..9


@dataclass(frozen=True)
class Copy:
    """Entry of the record.

    Attributes:
        stamp: size in bytes and time of change in nanoseconds of the source.
        suffix: file name extension of the copy.
        width, height: size of the copy in pixels.
        lens: key of the camera and its lens.
        focal, exposure: by EXIF, or None.
        turned, mirrored: orientation of the source.
        alpha: True where the source has an alpha channel, whose mask was written.
        notes: lines for the user.
        number: number of the frame in its video; 0 for a photograph.
    """

    stamp: tuple[int, int]
    suffix: str
    width: int
    height: int
    lens: str
    focal: float | None
    exposure: float | None
    turned: int
    mirrored: bool
    alpha: bool
    notes: tuple[str, ...] = ()
    number: int = 0

    @property
    def orientation(self) -> Orientation:
        """Orientation of the source."""
        return Orientation(self.turned, self.mirrored)

    def photograph(self, name: str, source: Path, folder: Path) -> Photograph:
        """Return the photograph of an entry.

        Args:
            name: name of the photograph.
            source: its file.
            folder: folder of the capture.
        """
        mask = mask_path(folder, name)
        known = self.width, self.height, self.lens, self.focal, self.exposure, self.turned
        return Photograph(name, source, copy_path(folder, name, self.suffix), *known, mask if mask.is_file() else None)


def copy_path(folder: Path, name: str, suffix: str) -> Path:
    """Return the path of a copy.

    Args:
        folder: folder of the capture.
        name: name of the photograph.
        suffix: .jpg or .png.
    """
    return folder / COPIES / f"{name}{suffix}"


def mask_path(folder: Path, name: str) -> Path:
    """Return the path of a photograph's given mask.

    Args:
        folder: folder of the capture.
        name: name of the photograph.
    """
    return folder / GIVEN_MASKS / f"{name}.png"


def stamp_of(file: Path) -> tuple[int, int]:
    """Return size and time of change of a file; raise InputError where it is gone."""
    try:
        known = file.stat()
    except OSError as error:
        raise InputError(file, f"can't be read ({error.strerror})") from error
    return known.st_size, known.st_mtime_ns


def copy_photograph(source: Path, name: str, folder: Path) -> Copy:
    """Decode a photograph and write its upright copy, and its alpha channel as a mask.

    Args:
        source: file of the user.
        name: name of the photograph.
        folder: folder of the capture.

    Raises:
        InputError: if the photograph can't be decoded.
    """
    stamp, decoded = stamp_of(source), decode_photograph(source)
    suffix = ".png" if decoded.lossless or decoded.colour.dtype == np.uint16 else ".jpg"
    data = source.read_bytes() if decoded.unchanged else encoded(decoded.colour, suffix)
    write_atomic(copy_path(folder, name, suffix), data)
    if decoded.alpha is not None:
        write_mask(mask_path(folder, name), decoded.alpha)
    return _entry(stamp, suffix, decoded)


def _entry(stamp: tuple[int, int], suffix: str, decoded: DecodedPhotograph) -> Copy:
    """Return the entry of a decoded photograph."""
    shot, size = decoded.shot, decoded.size
    known = lens_key(shot.lens, *size), shot.focal, shot.exposure, shot.orientation.turned, shot.orientation.mirrored
    return Copy(stamp, suffix, *size, *known, decoded.alpha is not None, decoded.notes)


def encoded(colour: np.ndarray, suffix: str) -> bytes:
    """Encode colours (H, W, 3) uint8 or uint16 as PNG, or as JPEG without subsampling.

    Args:
        colour: sRGB.
        suffix: .png or .jpg.
    """
    if suffix == ".png":
        return cv2.imencode(".png", np.ascontiguousarray(colour[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION])[1].tobytes()
    data = BytesIO()
    Image.fromarray(colour).save(data, "JPEG", quality=QUALITY, subsampling=0)
    return data.getvalue()


class Record:
    """Record of the copies in a capture's folder, written atomically.

    Args:
        folder: folder of the capture; a damaged record counts as none.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.copies: dict[str, Copy] = {}
        self.videos: dict[str, list[Any]] = {}
        self.masks: dict[str, list[Any]] = {}
        try:
            content = json.loads((folder / RECORD).read_text("utf-8"))
            if content["version"] == VERSION:
                copies = {n: _copy(c) for n, c in content["copies"].items()}
                videos = {n: _video(v) for n, v in content["videos"].items()}
                masks = {n: list(m) for n, m in content["masks"].items()}
                self.copies, self.videos, self.masks = copies, videos, masks
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return  # no record, or a damaged one: the copies are made again

    def valid(self, name: str, source: Path) -> Copy | None:
        """Return the entry of a copy that need not be made again.

        Args:
            name: name of the photograph.
            source: its file.
        """
        entry = self.copies.get(name)
        if entry is None or entry.stamp != stamp_of(source) or not copy_path(self.folder, name, entry.suffix).is_file():
            return None
        return None if entry.alpha and not mask_path(self.folder, name).is_file() else entry

    def write(self) -> None:
        """Write the record."""
        copies = {name: asdict(entry) for name, entry in self.copies.items()}
        content = {"version": VERSION, "copies": copies, "videos": self.videos, "masks": self.masks}
        write_atomic(self.folder / RECORD, json.dumps(content, indent=1).encode())


def _copy(content: dict[str, Any]) -> Copy:
    """Return an entry from JSON."""
    entry = Copy(**content)
    size, time = entry.stamp
    numbers = size, time, entry.width, entry.height, entry.turned, entry.number
    if entry.suffix not in (".jpg", ".png") or not all(isinstance(v, int) for v in numbers):
        raise ValueError("not an entry")
    return replace(entry, stamp=(size, time), notes=tuple(map(str, entry.notes)))


def _video(content: list[Any]) -> list[Any]:
    """Return the entry of a video from JSON: its stamp, the number of windows, and the numbers of its frames."""
    size, time, count, numbers = content
    return [size, time, count, [int(n) for n in numbers]]
