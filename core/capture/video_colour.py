# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of video frames: conversion to 8-bit sRGB."""

from __future__ import annotations

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace

from .coded_colour import coded_to_srgb, is_srgb

MATRICES = {1: Colorspace.ITU709, 4: Colorspace.FCC, 5: Colorspace.ITU601, 6: Colorspace.ITU601, 7: Colorspace.SMPTE240M}
BT2020_MATRIX = 9  # luma coefficients, by libswscale's number of the same value
HD = 720  # rows from which on an unstated matrix is BT.709


def frame_to_srgb(frame: av.VideoFrame) -> np.ndarray:
    """Convert a decoded frame to (H, W, 3) uint8 sRGB; highlights above diffuse white are clipped.

    Args:
        frame: as decoded, of any pixel format.
    """
    transfer, primaries = int(frame.color_trc), int(frame.color_primaries)
    matrix = _matrix(frame)
    if is_srgb(transfer, primaries):
        return frame.to_ndarray(format="rgb24", src_colorspace=matrix, dst_color_range=ColorRange.JPEG)
    deep = frame.to_ndarray(format="rgb48le", src_colorspace=matrix, dst_color_range=ColorRange.JPEG)
    return coded_to_srgb(deep, transfer, primaries)


def _matrix(frame: av.VideoFrame) -> int:
    """Return libswscale's number of the luma coefficients, which it would otherwise take for BT.601."""
    stated = int(frame.colorspace)
    if stated in (BT2020_MATRIX, 10):
        return BT2020_MATRIX
    return int(MATRICES.get(stated, Colorspace.ITU709 if frame.height >= HD else Colorspace.ITU601))
