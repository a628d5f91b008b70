# SPDX-License-Identifier: GPL-3.0-or-later
"""Images: decoding of photographs and masks (PNG, JPEG, EXR), and their reduction to a smaller size."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from ..errors import InputError
from .exr import check_filled, check_pixels, exr_size, read_exr
from .srgb import decode_srgb, encode_srgb

BAND = 256  # rows held as linear floats at a time: a whole 50-megapixel photograph would take gigabytes
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by PNG's colour type
EXR_SIGNATURE = b"\x76\x2f\x31\x01"


@dataclass(frozen=True, eq=False)
class DecodedImage:
    """Decoded image with sRGB-encoded, straight (not premultiplied) colour.

    Attributes:
        colour: (H, W, 3) float32 in 0..1, above 1 in HDR files; uint8 or uint16 as read, until `reduce_image`.
        alpha: (H, W) of the same dtype, or None.
    """

    colour: np.ndarray
    alpha: np.ndarray | None

    @property
    def size(self) -> tuple[int, int]:
        """Size as (width, height) in pixels."""
        return self.colour.shape[1], self.colour.shape[0]


def image_size(path: Path) -> tuple[int, int]:
    """Return (width, height) in pixels from the header alone.

    Raises:
        InputError: if the file is not a PNG, JPEG or EXR, or claims more pixels than allowed or than it can hold.
    """
    try:
        with path.open("rb") as file:
            head, size = file.read(26), path.stat().st_size
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error
    if head[:4] == EXR_SIGNATURE:
        return exr_size(path)
    if head[:8] == PNG_SIGNATURE and head[12:16] == b"IHDR":
        sides = int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
        check_pixels(path, *sides)
        # A byte of a PNG can't encode more than 1032 bytes of pixels (deflate), a byte of a JPEG no more than 341 pixels.
        bits = head[24] * PNG_CHANNELS.get(head[25], 1) if len(head) == 26 else 1
        check_filled(path, sides[0] * sides[1] * bits // 8, 1032 * size)
    width, height = _raster_size(path)
    check_pixels(path, width, height)
    if head[:8] != PNG_SIGNATURE:
        check_filled(path, width * height, 341 * size)
    return width, height


def png_bits(path: Path) -> int | None:
    """Return the bits of each value of a PNG from its header, such as 8 or 16; None for another file.

    Raises:
        InputError: if the file can't be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(26)
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error
    return head[24] if head[:8] == PNG_SIGNATURE and head[12:16] == b"IHDR" and len(head) == 26 else None


def _raster_size(path: Path) -> tuple[int, int]:
    try:
        with Image.open(path, formats=("PNG", "JPEG")) as image:
            return image.size
    except Exception as error:  # Pillow raises OSError, SyntaxError, ValueError, struct.error, ... for broken files
        raise InputError(path, f"not a readable PNG, JPEG or EXR image ({_reason(path, error)})") from error


def read_image(path: Path) -> DecodedImage:
    """Decode a PNG (8 or 16 bit), JPEG or EXR (linear, premultiplied); integers stay as they are stored.

    The EXIF orientation is never applied: cameras are solved for the pixels as stored.

    Raises:
        InputError: if the file is unreadable, truncated or has pixels that are not finite.
    """
    image_size(path)
    data = path.read_bytes()
    if data[:4] == EXR_SIGNATURE:
        return _read_exr(path)
    pixels = _decode(path, data)
    colour = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, -1)
    return DecodedImage(colour, pixels[..., -1] if pixels.shape[2] in (2, 4) else None)


def read_mask(path: Path) -> np.ndarray:
    """Read a mask (H, W) float32 in 0..1, 1 on the object: the alpha channel of the image if it is not opaque, else its largest channel.

    Raises:
        InputError: if the file can't be decoded.
    """
    image = read_image(path)
    alpha = None if image.alpha is None else to_unit_range(image.alpha)
    return alpha if alpha is not None and alpha.min() < 1 else np.clip(to_unit_range(image.colour.max(-1)), 0, 1)


def read_depth_mask(path: Path, far: float) -> np.ndarray:
    """Read a mask (H, W) float32 from a depth map: 1 where the depth is less than `far`, else 0.

    Args:
        path: the depth map, whose integers span 0..1.
        far: depth of the background in 0..1.

    Raises:
        InputError: if the file can't be decoded.
    """
    return (to_unit_range(read_image(path).colour[..., 0]) < far).astype(np.float32)


def _decode(path: Path, data: bytes) -> np.ndarray:
    """Decode to (H, W, 1..4) uint8 or uint16. Pillow checks every file, since OpenCV returns half an image of a truncated file."""
    try:
        with Image.open(BytesIO(data), formats=("PNG", "JPEG")) as image:
            image.load()
            deep = data[:8] == PNG_SIGNATURE and data[24] == 16
            pixels = decode_deep_png(data) if deep else np.asarray(_eight_bit(image))
    except Exception as error:  # see _raster_size
        raise InputError(path, f"unreadable or truncated image ({_reason(path, error)})") from error
    return pixels.reshape(*pixels.shape[:2], -1)


def _eight_bit(image: Image.Image) -> Image.Image:
    if image.mode in ("L", "LA", "RGB", "RGBA") and "transparency" not in image.info:
        return image
    return image.convert("RGBA" if "transparency" in image.info or image.mode in ("PA", "RGBa", "La") else "RGB")


def decode_deep_png(data: bytes) -> np.ndarray:
    """Decode a 16-bit PNG with OpenCV to (H, W) or (H, W, 1..4) uint16, since Pillow keeps only 8 bits of its colours.

    Args:
        data: content of the file.

    Raises:
        ValueError: if it can't be decoded.
    """
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise ValueError("not decodable")
    order = {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGBA}
    return cv2.cvtColor(pixels, order[pixels.shape[2]]) if pixels.ndim == 3 else pixels


def _read_exr(path: Path) -> DecodedImage:
    channels = read_exr(path)
    grey = channels.get("Y", next(iter(channels.values()))) if len(channels) == 1 or "Y" in channels else None
    missing = [c for c in "RGB" if c not in channels]
    if grey is None and missing:
        raise InputError(path, f"has the channels {', '.join(channels)} but not {', '.join(missing)}")
    linear = np.stack([channels[c] if grey is None else grey for c in "RGB"], -1)
    alpha = channels.get("A")
    if not np.isfinite(linear).all() or (alpha is not None and not np.isfinite(alpha).all()):
        raise InputError(path, "has pixels that are not finite")
    if alpha is not None:
        alpha = np.clip(alpha, 0, 1)
        linear = _straight(linear, alpha)
    return DecodedImage(encode_srgb(linear), alpha)


def to_unit_range(pixels: np.ndarray) -> np.ndarray:
    """Convert integers of an array (...,) to float32 in 0..1; return floats unchanged."""
    return pixels.astype(np.float32) / np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else pixels


def reduce_image(image: DecodedImage, width: int, height: int) -> DecodedImage:
    """Reduce an image to float pixels of another size by area averaging in linear light, with colour weighted by alpha.

    Args:
        image: the image; only converted to floats if it has that size already.
        width: of the result in pixels.
        height: of the result in pixels.
    """
    if image.size == (width, height):
        return DecodedImage(to_unit_range(image.colour), None if image.alpha is None else to_unit_range(image.alpha))
    # Area averaging is separable: first the width is reduced band by band, then the height.
    starts = range(0, image.size[1], BAND)
    narrow = np.concatenate([_narrow_band(image, slice(i, i + BAND), width) for i in starts])
    small = _area(narrow, width, height)
    if image.alpha is None:
        return DecodedImage(encode_srgb(small), None)
    return DecodedImage(encode_srgb(_straight(small[..., :3], small[..., 3])), np.ascontiguousarray(small[..., 3]))


def _narrow_band(image: DecodedImage, rows: slice, width: int) -> np.ndarray:
    """Reduce the width of some rows; return (rows, width, 3 or 4) linear, premultiplied where there is alpha."""
    linear = decode_srgb(to_unit_range(image.colour[rows]))
    if image.alpha is not None:
        alpha = to_unit_range(image.alpha[rows])[..., None]
        linear = np.concatenate([linear * alpha, alpha], -1)
    return _area(linear, width, len(linear))


def reduce_mask(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """Reduce a mask to another size by area averaging.

    Args:
        mask: (H, W) float32 in 0..1; returned as it is if it has that size already.
        width: of the result in pixels.
        height: of the result in pixels.
    """
    return mask if mask.shape == (height, width) else _area(mask, width, height)


def on_black(image: DecodedImage) -> DecodedImage:
    """Composite a float image over black in linear light; the result has no alpha."""
    if image.alpha is None:
        return image
    return DecodedImage(encode_srgb(decode_srgb(image.colour) * image.alpha[..., None]), None)


def _area(pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    return cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)


def _straight(premultiplied: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return np.where(alpha[..., None] > 1e-6, premultiplied / np.maximum(alpha, 1e-6)[..., None], 0)


def _reason(path: Path, error: Exception) -> str:
    """Return an error of Pillow in one line, without the path, which the message begins with."""
    text = str(error).replace(f" {str(path)!r}", "")
    return text.split("\n")[0].split(": <_io")[0].split(" <_io")[0][:120] or type(error).__name__
