# SPDX-License-Identifier: GPL-3.0-or-later
"""Corners of a black square to a tenth of a pixel, as intersections of lines that are fitted to its edges in linear light.

In sRGB-encoded values a blurred edge seems to lie further inside the black, which would make the square too small.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from ..io.srgb import decode_srgb

EDGE_REACH = 1 / 12  # pixels searched on both sides of an edge, in sides of the square; half of the border of a marker with six cells
MIN_EDGE_REACH = 2.5  # pixels
STEP = 0.25  # pixels between two samples across an edge
MARGIN = 0.15  # fraction of a side that is left out at both ends
MIN_CONTRAST = 0.05  # between black and white, linear
MIN_SAMPLES = 5  # places along a side
MAX_CORNER_MOVE = 4.0  # pixels; a corner that moves further was no corner

Line = tuple[np.ndarray, float]  # unit normal n and distance d: n . x = d


def refine_corners(grey: np.ndarray, corners: np.ndarray) -> np.ndarray | None:
    """Refine the corners of a black square on white.

    Args:
        grey: (H, W) uint8, sRGB-encoded.
        corners: (4, 2) pixels in order along the outline; the first pixel's centre is at (0, 0).

    Returns:
        Corners (4, 2) float64; None where the edges are not clear.
    """
    corners = corners.astype(float)
    low = np.maximum(np.floor(corners.min(0)).astype(int) - 20, 0)
    high = np.ceil(corners.max(0)).astype(int) + 20
    linear = decode_srgb(grey[low[1] : high[1], low[0] : high[0]].astype(np.float32) / 255).astype(np.float32)
    lines = []
    for start, end in zip(corners - low, np.roll(corners, -1, 0) - low, strict=True):
        line = _fit_edge(linear, start, end, corners.mean(0) - low)
        if line is None:
            return None
        lines.append(line)
    normals = np.array([[lines[k - 1][0], lines[k][0]] for k in range(4)])
    distances = np.array([[lines[k - 1][1], lines[k][1]] for k in range(4)])
    if (np.abs(np.linalg.det(normals)) < 0.05).any():
        return None
    refined = np.linalg.solve(normals, distances[..., None])[..., 0] + low
    return refined if np.abs(refined - corners).max() < MAX_CORNER_MOVE else None


def _fit_edge(linear: np.ndarray, start: np.ndarray, end: np.ndarray, centre: np.ndarray) -> Line | None:
    """Fit a line to where the profiles across an edge cross the middle between its black and white sides."""
    length = np.linalg.norm(end - start)
    along = (end - start) / length
    outward = np.array([along[1], -along[0]])
    outward = -outward if outward @ (centre - start) > 0 else outward
    reach = max(MIN_EDGE_REACH, EDGE_REACH * length)
    across = np.arange(-reach, reach + 1e-6, STEP)
    places = start + np.linspace(MARGIN, 1 - MARGIN, max(8, int(length)))[:, None] * (end - start)
    x, y = np.moveaxis(places[:, None] + across[:, None] * outward, -1, 0)
    profiles = map_coordinates(linear, [y, x], order=3, mode="nearest")  # OpenCV's remap rounds places to 1/32 pixel
    offset, clear = _crossings(profiles, across)
    if clear.sum() < MIN_SAMPLES:
        return None
    return _fit_line((places + offset[:, None] * outward)[clear])


def _crossings(profiles: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where profiles (N, S) sampled at `across` (S,) first rise above the middle of their ends (N,), and which do clearly (N,)."""
    ends = max(1, len(across) // 6)
    black, white = profiles[:, :ends].mean(1), profiles[:, -ends:].mean(1)
    middle = (black + white) / 2
    above = (profiles > middle[:, None]).argmax(1)
    clear, above, row = (above > 0) & (white - black > MIN_CONTRAST), np.maximum(above, 1), np.arange(len(profiles))
    rise = profiles[row, above] - profiles[row, above - 1]
    return across[above - 1] + STEP * (middle - profiles[row, above - 1]) / np.maximum(rise, 1e-6), clear


def _fit_line(places: np.ndarray) -> Line:
    """Fit a line to places (N, 2) by total least squares, without those further off than three times the median."""
    keep = np.ones(len(places), bool)
    normal, distance = np.zeros(2), 0.0
    for _ in range(3):
        mean = places[keep].mean(0)
        normal = np.linalg.svd(places[keep] - mean)[2][1]
        distance = float(normal @ mean)
        off = np.abs(places @ normal - distance)
        keep = off <= max(3 * np.median(off), 0.1)
    return normal, distance
