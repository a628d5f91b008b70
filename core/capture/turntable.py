# SPDX-License-Identifier: GPL-3.0-or-later
"""Turntable: photographs of a fixed camera before which the object turns, and what stays at its place in them.

Features on a static background contradict those on the object, so that cameras are found from what moves. What stays the same at the same
pixel is found by statistics over all photographs; it also tells the exposure of each photograph, and what is not the object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from PIL import Image

from ..errors import Cancelled, InputError
from ..io.srgb import decode_srgb, encode_srgb
from ..progress.protocol import Progress
from ..settings.schema import Choice
from .photograph import Photograph

MAX_SIDE = 320  # longest side of the compared images, pixels
MIN_PHOTOGRAPHS = 8  # photographs from which statistics are meaningful
ROUNDS = 3  # alternations between the median image and the gains
MIN_MEDIAN, MAX_MEDIAN = 0.02, 0.9  # linear medians from which gains are estimated
WINDOW, MAX_NOISE = 3, 0.04  # pixels averaged, and encoded difference below which a pixel shows the background
MIN_STATIC_FRACTION = 0.5  # fraction of the photographs that must show the background at a static pixel
TEXTURE_PATCH, MIN_TEXTURE = 7, 0.03  # pixels, and encoded standard deviation in them, from which a place has texture
MIN_TEXTURED_BACKGROUND = 0.02  # fraction of the pixels that must be static and have texture; moving cameras leave less than 0.001
# Fraction of the pixels that must be static, with or without texture, where the user says that the camera is fixed.
MIN_PLAIN_BACKGROUND = 0.1
MIN_MOVING_FRACTION = 0.01  # fraction of the pixels that must not be static: the object
MAX_GAP = 5  # pixels across which holes in what moves are closed
MOVING_RIM = 3  # pixels at the rim of what moves whose features may belong to the background


@dataclass(frozen=True, eq=False)
class Turntable:
    """Static background of N photographs of one fixed camera.

    Attributes:
        moving: (N, h, w) bool, False where a photograph shows the static background; of the upright copies, reduced to MAX_SIDE.
        gains: (N, 3) linear exposure gains of the photographs, of geometric mean 1.
    """

    moving: np.ndarray
    gains: np.ndarray

    def moving_features(self, number: int, places: np.ndarray) -> np.ndarray:
        """Return which features of a photograph lie on what moves, (K,) bool.

        Args:
            number: index of the photograph.
            places: (K, 2) x and y in 0..1 of the upright copy's width and height.
        """
        inner = cv2.erode(self.moving[number].astype(np.uint8), np.ones((MOVING_RIM, MOVING_RIM), np.uint8))
        height, width = inner.shape
        column = np.clip((places[:, 0] * width).astype(int), 0, width - 1)
        row = np.clip((places[:, 1] * height).astype(int), 0, height - 1)
        return inner[row, column] > 0


def find_turntable(photographs: Sequence[Photograph], choice: Choice, progress: Progress) -> Turntable | None:
    """Find out whether the camera was fixed before a turning object, and what stays the same.

    Args:
        photographs: photographs in the order of capture.
        choice: "off": they are not of a turntable; "on": they are; "auto": where a background with texture stays at its place.
        progress: receives a message, and may cancel.

    Returns:
        The static background; None where the camera moved.

    Raises:
        InputError: if `choice` is "on" and the camera evidently moved, or nothing turns.
        Cancelled: if the user stopped the work.
    """
    reason = _reason_against(photographs)
    if choice == "off" or (choice == "auto" and reason):
        return None
    if reason:
        raise InputError("capture.turntable", reason, "a turntable needs one fixed camera and a turn of the object")
    encoded = np.stack([_read(one, progress) for one in photographs])
    gains, median = background_statistics(encoded)
    still = np.stack([still_pixels(one, gain, median) for one, gain in zip(encoded, gains, strict=True)])
    static = still.mean(0) > MIN_STATIC_FRACTION
    around = (
        cv2.erode(static.astype(np.uint8), np.ones((TEXTURE_PATCH, TEXTURE_PATCH), np.uint8)) > 0
    )  # the object's outline is no texture of it
    textured, turning = float((around & has_texture(median)).mean()), 1 - float(static.mean())
    if choice == "auto" and (textured < MIN_TEXTURED_BACKGROUND or turning < MIN_MOVING_FRACTION):
        return None
    if textured < MIN_TEXTURED_BACKGROUND and static.mean() < MIN_PLAIN_BACKGROUND:
        what = f"only {static.mean():.1%} of the pixels stay the same over the photographs: the camera moved"
        raise InputError("capture.turntable", what, "fix the camera and turn the object, or leave the setting out")
    if turning < MIN_MOVING_FRACTION:
        raise InputError("capture.turntable", "nothing moves in the photographs", "turn the object between them")
    progress.message(f"turntable: {static.mean():.0%} of the pixels stay the same; cameras are found from what turns")
    return Turntable(np.stack([_closed(~(one & static)) for one in still]), gains)


def _reason_against(photographs: Sequence[Photograph]) -> str:
    """Return the reason why photographs can't be of one fixed camera, empty where there is none."""
    if len(photographs) < MIN_PHOTOGRAPHS:
        return f"there are {len(photographs)} photographs, fewer than {MIN_PHOTOGRAPHS}"
    alike = len({(one.width, one.height, one.turned, one.lens) for one in photographs}) == 1
    return "" if alike else "the photographs have several sizes or lenses"


def _read(photograph: Photograph, progress: Progress) -> np.ndarray:
    """Read a photograph (h, w, 3) float32, encoded 0..1, reduced to MAX_SIDE."""
    if progress.cancelled:
        raise Cancelled("stopped while a turntable was looked for")
    with Image.open(photograph.image) as image:
        image.draft("RGB", (MAX_SIDE, MAX_SIDE))
        colour = np.asarray(image.convert("RGB"))
    scale = min(1.0, MAX_SIDE / max(photograph.width, photograph.height))
    size = max(round(photograph.width * scale), 1), max(round(photograph.height * scale), 1)
    return cv2.resize(colour, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255


def background_statistics(encoded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate exposure gains and the static background by medians over the photographs.

    Args:
        encoded: (N, h, w, 3) sRGB-encoded photographs.

    Returns:
        Linear gains (N, 3) of geometric mean 1, and the encoded median image (h, w, 3) of the photographs divided by them.
    """
    linear, gains = decode_srgb(encoded).astype(np.float32), np.ones((len(encoded), 3), np.float32)
    for _ in range(ROUNDS):
        median = np.median(linear / gains[:, None, None], 0)
        usable = ((median > MIN_MEDIAN) & (median < MAX_MEDIAN)).all(-1)
        if not usable.any():
            break
        ratio = np.stack([np.median(one[usable] / median[usable], 0) for one in linear]).clip(1e-3, 1e3)
        gains = (ratio / np.exp(np.log(ratio).mean(0))).astype(np.float32)
    return gains.astype(np.float64), encode_srgb(np.median(linear / gains[:, None, None], 0))


def still_pixels(encoded: np.ndarray, gain: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Return where a photograph shows the background, (h, w) bool.

    Args:
        encoded: (h, w, 3) sRGB-encoded.
        gain: (3,) its linear gain.
        background: (h, w, 3) encoded, of gain 1.
    """
    expected = encode_srgb(np.clip(decode_srgb(background) * gain, 0, 1)).astype(np.float32)  # clipped as the photograph is
    return np.abs(cv2.blur(encoded - expected, (WINDOW, WINDOW))).max(-1) < MAX_NOISE


def has_texture(encoded: np.ndarray) -> np.ndarray:
    """Return where an encoded image (h, w, 3) has texture, (h, w) bool."""
    grey = encoded.mean(-1).astype(np.float32)
    mean, square = cv2.blur(grey, (TEXTURE_PATCH, TEXTURE_PATCH)), cv2.blur(grey * grey, (TEXTURE_PATCH, TEXTURE_PATCH))
    return np.sqrt(np.maximum(square - mean * mean, 0)) > MIN_TEXTURE


def _closed(moving: np.ndarray) -> np.ndarray:
    """Return what moves (h, w) without single pixels and small holes, where the object has the background's colour."""
    image, window = moving.astype(np.uint8), np.ones((MAX_GAP, MAX_GAP), np.uint8)
    image = cv2.morphologyEx(image, cv2.MORPH_OPEN, np.ones((WINDOW, WINDOW), np.uint8))
    return cv2.morphologyEx(image, cv2.MORPH_CLOSE, window) > 0
