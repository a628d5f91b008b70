# SPDX-License-Identifier: GPL-3.0-or-later
"""Decoding of a photograph of any kind to upright sRGB pixels."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pillow_heif
from PIL import Image

from ..errors import InputError
from ..io.exr import MAX_PIXELS, check_filled, check_pixels
from ..io.image import image_size
from .coded_colour import coded_to_srgb, is_srgb
from .colour_profile import UnusableProfileError, to_srgb
from .exif import Orientation, Shot, read_shot
from .photograph_files import RAW
from .raw import decode_raw

FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "HEIF")  # files of several JPEGs (MPO) are opened as JPEG
LOSSLESS = ("PNG", "TIFF")
MAX_DEFLATE_RATIO = 8 * 1032  # largest number of pixels of one bit in a byte of a compressed TIFF
# Largest number of pixels in a byte of HEIC and WebP, whose formats set no limit; photographs have less than 100.
MAX_COMPRESSED_RATIO = 2000
MAX_FILE_BYTES = 8 * MAX_PIXELS  # bytes of a file: four channels of 16 bits
BITS_PER_SAMPLE = 258  # tag of TIFF

Image.init()  # here, since threads must not do it at the same time
pillow_heif.register_heif_opener()


@dataclass(frozen=True, eq=False)
class DecodedPhotograph:
    """Decoded photograph, upright, in sRGB.

    Attributes:
        colour: (H, W, 3) uint8, or uint16 where the file has more than 8 bits.
        alpha: (H, W) of the same type, or None where the file has no alpha or an opaque one.
        shot: EXIF; its orientation has been applied.
        lossless: True where the file has no loss of compression.
        unchanged: True where the file is a JPEG whose pixels are upright and sRGB already.
        notes: lines for the user, without the file's name.
    """

    colour: np.ndarray
    alpha: np.ndarray | None
    shot: Shot
    lossless: bool
    unchanged: bool
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Size as (width, height) in pixels."""
        return self.colour.shape[1], self.colour.shape[0]


def decode_photograph(path: Path) -> DecodedPhotograph:
    """Decode a photograph and turn it upright; of a file with several images (gain map, depth, burst) the first.

    Args:
        path: JPEG, PNG, TIFF, WebP, HEIC or RAW.

    Raises:
        InputError: if the file is unreadable, truncated, or claims more pixels than allowed or than it can hold.
    """
    if path.suffix.lower() in RAW:
        colour, shot = decode_raw(path)
        return DecodedPhotograph(shot.orientation.upright(colour), None, shot, lossless=True, unchanged=False)
    if _size(path) > MAX_FILE_BYTES:
        raise InputError(path, "is larger than any photograph", "remove it")
    try:
        data = path.read_bytes()  # Pillow would allocate what a damaged file claims for a part of it
        with Image.open(BytesIO(data), formats=FORMATS) as image:
            _check(path, image)
            return _decoded(path, image, data)
    except InputError:
        raise
    except Exception as error:  # Pillow raises OSError, SyntaxError, ValueError, struct.error, ... for broken files
        reason = str(error).split("\n")[0].split(" <_io")[0].replace(str(path), "").strip(" '\"")[:120] or type(error).__name__
        raise InputError(path, f"unreadable or truncated photograph ({reason})", "copy it again, or remove it") from error


def _size(path: Path) -> int:
    """Return the size of a file in bytes."""
    try:
        return path.stat().st_size
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error


def _check(path: Path, image: Image.Image) -> None:
    """Check what the header claims before pixels are decoded."""
    if image.format in ("PNG", "JPEG", "MPO"):
        image_size(path)
        return
    check_pixels(path, *image.size)
    check_filled(
        path, image.width * image.height, (MAX_DEFLATE_RATIO if image.format == "TIFF" else MAX_COMPRESSED_RATIO) * path.stat().st_size
    )


def _decoded(path: Path, image: Image.Image, data: bytes) -> DecodedPhotograph:
    """Decode an opened image."""
    image.load()
    shot, profile, notes = read_shot(image), image.info.get("icc_profile"), []
    pixels = _deep(path, image, data)
    converted = None
    if pixels is None:
        pixels, converted = _with_profile(image, profile, notes)
    elif profile:
        shallow = Image.fromarray((pixels[..., :3] >> 8).astype(np.uint8))
        converted = _convert(shallow, profile, notes)
        if converted is not None:
            pixels = np.dstack([np.asarray(converted), (pixels[..., 3:] >> 8).astype(np.uint8)])
            notes.append("reduced to 8 bits, since its colours had to be converted to sRGB")
    colour, alpha = shot.orientation.upright(pixels[..., :3]), None
    if pixels.shape[2] == 4 and pixels[..., 3].min() < np.iinfo(pixels.dtype).max:
        alpha = shot.orientation.upright(pixels[..., 3])
    plain = image.format in ("JPEG", "MPO") and image.mode in ("RGB", "L") and converted is None
    unchanged = plain and shot.orientation == Orientation()
    return DecodedPhotograph(colour, alpha, shot, image.format in LOSSLESS, unchanged, (*filter(None, [shot.note]), *notes))


def _deep(path: Path, image: Image.Image, data: bytes) -> np.ndarray | None:
    """Decode a file of 16 bits with OpenCV to (H, W, 3 or 4) uint16, since Pillow keeps only 8 of colours; None for other files."""
    if image.mode in ("I", "F"):
        raise InputError(path, f"has {'floating-point' if image.mode == 'F' else '32-bit'} pixels", "save it with 8 or 16 bits")
    bits = getattr(image, "tag_v2", {}).get(BITS_PER_SAMPLE, (8,)) if image.format == "TIFF" else (8,)
    if not (data[24] == 16 if image.format == "PNG" else max(bits) == 16):
        return None
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype != np.uint16:
        raise ValueError("not decodable")
    if pixels.ndim == 2:
        return np.repeat(pixels[..., None], 3, -1)
    return cv2.cvtColor(pixels, {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGBA}[pixels.shape[2]])


def _with_profile(image: Image.Image, profile: bytes | None, notes: list[str]) -> tuple[np.ndarray, Image.Image | None]:
    """Return pixels (H, W, 3 or 4) uint8 in sRGB, and the converted image where the profile changed its colours."""
    clear = "transparency" in image.info or image.mode in ("RGBA", "LA", "PA", "RGBa", "La")
    alpha = [np.asarray(image.convert("RGBA"))[..., 3]] if clear else []
    base = image if image.mode in ("RGB", "L", "CMYK") else image.convert("RGB")
    converted = _convert(base, profile, notes) if profile else None
    colour = np.asarray(converted or base.convert("RGB"))
    coded = image.info.get("nclx_profile")  # of HEIC
    if coded and not profile and not is_srgb(coded["transfer_characteristics"], coded["color_primaries"]):
        colour = coded_to_srgb(colour, coded["transfer_characteristics"], coded["color_primaries"])
    return np.dstack([colour, *alpha]), converted


def _convert(image: Image.Image, profile: bytes, notes: list[str]) -> Image.Image | None:
    """Convert an image to sRGB; a profile that can't be used is noted."""
    try:
        return to_srgb(image, profile)
    except UnusableProfileError as error:
        notes.append(f"its colour profile can't be used and sRGB is assumed ({error})")
        return None
