# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs, masks and videos of a capture for the fuzzer, and their readers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pillow_heif
from formats.photographs import write_dng, write_video
from irgspp.core.capture.decoding import decode_photograph
from irgspp.core.capture.exif import Orientation
from irgspp.core.capture.given_masks import write_given_mask
from irgspp.core.capture.video import sharp_frames
from irgspp.core.progress.protocol import Silent
from PIL import Image, ImageCms

PHOTOGRAPHS = ("photo.jpg", "photo.heic", "photo.webp", "photo.png", "deep.png", "photo.tif", "deep.tif", "photo.dng")
MASKS = ("mask.png", "mask.jpg")
VIDEOS = ("video.mp4", "video.mkv")
SIZE = (24, 32)  # rows and columns


def write_photographs(folder: Path) -> None:
    """Write a photograph of every kind, with EXIF and a colour profile where it can have them.

    Args:
        folder: folder of the files.
    """
    pixels = _pixels()
    image, exif, profile = Image.fromarray(pixels), _exif(), ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    pillow_heif.register_heif_opener()
    for name in ("photo.jpg", "photo.heic", "photo.webp", "photo.png"):
        image.save(folder / name, exif=exif, icc_profile=profile)
    image.save(folder / "photo.tif", compression="tiff_lzw")
    for name in ("deep.png", "deep.tif"):
        cv2.imwrite(str(folder / name), pixels.astype(np.uint16) * 257)
    write_dng(folder / "photo.dng", pixels / 255)


def write_masks(folder: Path) -> None:
    """Write masks.

    Args:
        folder: folder of the files.
    """
    for name in MASKS:
        Image.fromarray(_pixels()[..., 0]).save(folder / name)


def read_given_mask(folder: Path, file: Path) -> object:
    """Turn a mask as its photograph was.

    Args:
        folder: folder of the file.
        file: file to read.
    """
    write_given_mask(file, SIZE, Orientation(3), folder / "turned.png")
    return (folder / "turned.png").read_bytes()


def write_videos(folder: Path) -> None:
    """Write videos of 16 frames.

    Args:
        folder: folder of the files.
    """
    frames = [np.roll(_pixels(), i, 1) for i in range(16)]
    for name in VIDEOS:
        write_video(folder / name, frames, turned=1 if name.endswith("mp4") else 0)


def read_video(folder: Path, file: Path) -> object:
    """Read sharp frames.

    Args:
        folder: folder of the file, unused.
        file: file to read.
    """
    return list(sharp_frames(file, 3, Silent()))


def read_photograph(folder: Path, file: Path) -> object:
    """Decode a photograph.

    Args:
        folder: folder of the file, unused.
        file: file to read.
    """
    return decode_photograph(file)


def _pixels() -> np.ndarray:
    """Return smooth random colours (H, W, 3) uint8."""
    noise = np.random.default_rng(0).integers(0, 256, (*SIZE, 3)).astype(np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 1.5)


def _exif() -> bytes:
    """Return EXIF with all that is read."""
    exif = Image.Exif()
    exif.update({0x010F: "Lab", 0x0110: "Camera", 0x0112: 6})
    known = {0x829A: (1, 60), 0x829D: (18, 10), 0x8827: 200, 0x920A: (45, 10), 0xA405: 28, 0xA20E: (1142857, 1000), 0xA210: 3, 0xA002: 32}
    exif.get_ifd(0x8769).update({t: v[0] / v[1] if isinstance(v, tuple) else v for t, v in known.items()})
    return exif.tobytes()
