# SPDX-License-Identifier: GPL-3.0-or-later
"""Light maps as files: lat-long images in .exr, .hdr, .png or .jpg."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from ..errors import InputError
from ..io.exr import check_pixels, read_exr_rgb
from ..io.image import read_image, unit
from ..io.srgb import decode_srgb

DIM = 1e-4  # stands for a light that is black everywhere
HDR_SIGNATURES = (b"#?RADIANCE", b"#?RGBE")
HDR_SIZE = re.compile(rb"\n[-+][XY] (\d{1,20}) [-+][XY] (\d{1,20})\n")
HDR_HEADER = 1 << 16  # bytes in which it must stand


def read_environment(path: Path) -> tuple[np.ndarray, list[str]]:
    """A light map (H, W, 3) float32 linear, finite and >= 0, and what is odd about the file or had to be repaired, a line each.

    .exr and .hdr hold linear values, anything else is taken for sRGB. NaN and negative texels become 0, infinite ones as bright as
    the brightest other, a black map a dim grey. Raises InputError where the file can't be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".exr":
        image = read_exr_rgb(path)
    elif suffix == ".hdr":
        image = _read_hdr(path)
    else:
        image = decode_srgb(unit(read_image(path).colour))
    return repaired(image, path)


def repaired(image: np.ndarray, where: object) -> tuple[np.ndarray, list[str]]:
    """A light map (H, W, 3) with only finite values >= 0, not all of them 0, float32, and lines that say what was changed or is odd."""
    remarks = []
    height, width = image.shape[:2]
    if width != 2 * height:
        remarks.append(f"{where}: is {width}x{height}, not twice as wide as high; it is stretched over the sphere all the same")
    brightest = float(max(image.max(where=np.isfinite(image), initial=0.0), 0.0))
    faults = [("not a number", np.isnan(image), 0.0), ("negative", image < 0, 0.0), ("infinite", np.isposinf(image), brightest)]
    for what, bad, value in faults:
        if texels := int(bad.any(-1).sum()):
            remarks.append(f"{where}: {texels} {'texels are' if texels > 1 else 'texel is'} {what}, set to {value:g}")
    whole = np.nan_to_num(image, nan=0.0, posinf=brightest, neginf=0.0)
    light = np.clip(whole, 0, np.finfo(np.float32).max).astype(np.float32)
    if not light.any():
        remarks.append(f"{where}: all {width * height} texels are black, set to a grey of {DIM:g}")
        light[:] = DIM
    return light, remarks


def _read_hdr(path: Path) -> np.ndarray:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error
    if not data.startswith(HDR_SIGNATURES):
        raise InputError(path, "not a Radiance image")
    if size := HDR_SIZE.search(data[:HDR_HEADER]):  # the decoder takes memory for whatever the header claims
        check_pixels(path, int(size[1]), int(size[2]))
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise InputError(path, f"not a readable Radiance image ({error.err})") from error
    if pixels is None or pixels.dtype != np.float32:
        raise InputError(path, "not a readable Radiance image")
    return np.ascontiguousarray(pixels[..., ::-1])
