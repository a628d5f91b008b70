# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours of video frames: conversion to 8-bit sRGB, of high dynamic range (HLG, PQ) by way of linear light."""

from __future__ import annotations

import functools

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace

from ..io.srgb import encode_srgb

PQ, HLG = 16, 18  # transfer characteristics (ITU-T H.273)
BT2020, P3 = 9, 12  # colour primaries
MATRICES = {1: Colorspace.ITU709, 4: Colorspace.FCC, 5: Colorspace.ITU601, 6: Colorspace.ITU601, 7: Colorspace.SMPTE240M}
BT2020_MATRIX = 9  # luma coefficients, by libswscale's number of the same value
HD = 720  # rows from which on an unstated matrix is BT.709
WHITE = 203.0  # cd/m2 of diffuse white in HDR video (ITU-R BT.2408), which becomes 1
HLG_WHITE = 0.75  # its signal in HLG
PEAK = 10_000.0  # cd/m2 of PQ's largest signal
TO_SRGB = {  # linear colours (rows: red, green, blue) of other primaries in those of sRGB
    BT2020: ((1.660491, -0.587641, -0.072850), (-0.124550, 1.132900, -0.008349), (-0.018151, -0.100579, 1.118730)),
    P3: ((1.224940, -0.224940, 0.0), (-0.042057, 1.042057, 0.0), (-0.019638, -0.078636, 1.098274)),
}


def frame_to_srgb(frame: av.VideoFrame) -> np.ndarray:
    """Convert a decoded frame to (H, W, 3) uint8 sRGB; highlights above diffuse white are clipped.

    Args:
        frame: as decoded, of any pixel format.
    """
    transfer, primaries = int(frame.color_trc), int(frame.color_primaries)
    matrix = _matrix(frame)
    wide = primaries in TO_SRGB
    if transfer not in (PQ, HLG) and not wide:
        return frame.to_ndarray(format="rgb24", src_colorspace=matrix, dst_color_range=ColorRange.JPEG)
    deep: np.ndarray = frame.to_ndarray(format="rgb48le", src_colorspace=matrix, dst_color_range=ColorRange.JPEG)
    linear = np.take(_linear_table(transfer), deep)
    if wide:
        linear = linear @ np.asarray(TO_SRGB[primaries], np.float32).T
    return np.round(255 * np.clip(encode_srgb(np.clip(linear, 0, 1)), 0, 1)).astype(np.uint8)


def _matrix(frame: av.VideoFrame) -> int:
    """Return libswscale's number of the luma coefficients, which it would otherwise take for BT.601."""
    stated = int(frame.colorspace)
    if stated in (BT2020_MATRIX, 10):
        return BT2020_MATRIX
    return int(MATRICES.get(stated, Colorspace.ITU709 if frame.height >= HD else Colorspace.ITU601))


@functools.cache
def _linear_table(transfer: int) -> np.ndarray:
    """Return linear light (65536,) float32 by signal, 1 at diffuse white."""
    signal = np.arange(65536) / 65535
    if transfer == HLG:  # inverse OETF of ITU-R BT.2100: scene light
        return (_hlg(signal) / _hlg(np.array(HLG_WHITE))).astype(np.float32)
    if transfer == PQ:  # EOTF of SMPTE ST 2084
        power = signal ** (1 / 78.84375)
        return (PEAK / WHITE * (np.maximum(power - 0.8359375, 0) / (18.8515625 - 18.6875 * power)) ** (1 / 0.1593017578125)).astype(
            np.float32
        )
    return np.where(signal <= 0.04045, signal / 12.92, ((signal + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _hlg(signal: np.ndarray) -> np.ndarray:
    """Return scene light 0..1 of an HLG signal."""
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((np.maximum(signal, 0.5) - 0.55991073) / 0.17883277) + 0.28466892) / 12)
