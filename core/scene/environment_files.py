# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of environment maps: lat-long images as .exr, .hdr, .png or .jpg."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from ..errors import InputError
from ..io.exr import check_pixels, read_exr_rgb
from ..io.image import read_image, to_unit_range
from ..io.srgb import decode_srgb

DIM = 1e-4  # radiance that replaces a light that is black everywhere
HDR_SIGNATURES = (b"#?RADIANCE", b"#?RGBE")
HDR_SIZE = re.compile(rb"\n[-+][XY] (\d{1,20}) [-+][XY] (\d{1,20})\n")
HDR_HEADER = 1 << 16  # bytes within which the header must end


def read_environment(path: Path) -> tuple[np.ndarray, list[str]]:
    """Read an environment map.

    .exr and .hdr hold linear values, all other files are decoded as sRGB. Texels are repaired as by `repair_environment`.

    Returns:
        The map (H, W, 3) float32 linear, finite and >= 0, and a line for each repair or oddity of the file.

    Raises:
        InputError: if the file can't be read.
    """
    suffix = path.suffix.lower()
    if suffix == ".exr":
        image = read_exr_rgb(path)
    elif suffix == ".hdr":
        image = _read_hdr(path)
    else:
        image = decode_srgb(to_unit_range(read_image(path).colour))
    return repair_environment(image, path)


def repair_environment(image: np.ndarray, where: object) -> tuple[np.ndarray, list[str]]:
    """Repair an environment map: NaN and negative texels become 0, infinite ones as bright as the brightest other, a black map dim grey.

    Args:
        image: (H, W, 3) linear radiance.
        where: its file or name, for the remarks.

    Returns:
        The map (H, W, 3) float32 with finite values >= 0 that are not all 0, and a line for each repair or oddity.
    """
    remarks = []
    height, width = image.shape[:2]
    if width != 2 * height:
        remarks.append(f"{where}: is {width}x{height}, not twice as wide as high; it is stretched over the whole sphere")
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
        raise InputError(path, "not a Radiance HDR image")
    if size := HDR_SIZE.search(data[:HDR_HEADER]):  # the decoder allocates memory for all that the header claims
        check_pixels(path, int(size[1]), int(size[2]))
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise InputError(path, f"not a readable Radiance HDR image ({error.err})") from error
    if pixels is None or pixels.dtype != np.float32:
        raise InputError(path, "not a readable Radiance HDR image")
    return np.ascontiguousarray(pixels[..., ::-1])
