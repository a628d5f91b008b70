# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours whose primaries and transfer curve are stated by number (ITU-T H.273), as in HEIC and video: conversion to sRGB."""

from __future__ import annotations

import functools

import numpy as np

from ..io.quantisation import srgb_eight_bits
from ..io.srgb import decode_srgb

PQ, HLG = 16, 18  # transfer characteristics of high dynamic range
BT2020, P3 = 9, 12  # colour primaries
WHITE = 203.0  # cd/m2 of diffuse white in HDR video (ITU-R BT.2408), which becomes 1
HLG_WHITE = 0.75  # its signal in HLG
PEAK = 10_000.0  # cd/m2 of PQ's largest signal
BAND = 256  # rows held as floats at a time
TO_SRGB = {  # linear colours (rows: red, green, blue) of other primaries in those of sRGB
    BT2020: ((1.660491, -0.587641, -0.072850), (-0.124550, 1.132900, -0.008349), (-0.018151, -0.100579, 1.118730)),
    P3: ((1.224940, -0.224940, 0.0), (-0.042057, 1.042057, 0.0), (-0.019638, -0.078636, 1.098274)),
}


def is_srgb(transfer: int, primaries: int) -> bool:
    """Return True where colours can be taken as sRGB: all but those of wide gamut or high dynamic range.

    Args:
        transfer: number of the transfer characteristics.
        primaries: number of the colour primaries.
    """
    return transfer not in (PQ, HLG) and primaries not in TO_SRGB


def coded_to_srgb(pixels: np.ndarray, transfer: int, primaries: int) -> np.ndarray:
    """Convert colours to 8-bit sRGB by way of linear light; highlights above diffuse white are clipped.

    Args:
        pixels: (H, W, 3) uint8 or uint16, full range.
        transfer: number of the transfer characteristics.
        primaries: number of the colour primaries.

    Returns:
        (H, W, 3) uint8.
    """
    bands = (pixels[i : i + BAND] for i in range(0, len(pixels), BAND))
    return np.concatenate([_converted(band, transfer, primaries) for band in bands])


def _converted(pixels: np.ndarray, transfer: int, primaries: int) -> np.ndarray:
    """Convert some rows."""
    linear = np.take(_linear_table(transfer, int(np.iinfo(pixels.dtype).max)), pixels)
    if primaries in TO_SRGB:
        linear = linear @ np.asarray(TO_SRGB[primaries], np.float32).T
    return srgb_eight_bits(linear)


@functools.cache
def _linear_table(transfer: int, largest: int) -> np.ndarray:
    """Return linear light (largest + 1,) float32 by signal, 1 at diffuse white."""
    signal = np.arange(largest + 1) / largest
    if transfer == HLG:  # inverse OETF of ITU-R BT.2100: scene light
        return (_hlg(signal) / _hlg(np.array(HLG_WHITE))).astype(np.float32)
    if transfer == PQ:  # EOTF of SMPTE ST 2084
        power = signal ** (1 / 78.84375)
        light = (np.maximum(power - 0.8359375, 0) / (18.8515625 - 18.6875 * power)) ** (1 / 0.1593017578125)
        return (PEAK / WHITE * light).astype(np.float32)
    return decode_srgb(signal).astype(np.float32)


def _hlg(signal: np.ndarray) -> np.ndarray:
    """Return scene light 0..1 of an HLG signal."""
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((np.maximum(signal, 0.5) - 0.55991073) / 0.17883277) + 0.28466892) / 12)
