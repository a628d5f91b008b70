# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of stereo's matching cost: every sample of a patch is warped by the plane's homography."""

from __future__ import annotations

import numpy as np

from ...scene.camera import Camera
from ..constants import BRIGHTNESS_RANGE, FLAT_VARIANCE, PATCH_REACH, PATCH_SPACING, WEAK_VARIANCE, WEIGHT_CUT, WORST_COST


def patch_weights(grey: np.ndarray, inside: np.ndarray, row: int, column: int, sigma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the pixels of a patch with their bilateral weights.

    Args:
        grey: (H, W) grey values in 0..1.
        inside: (H, W) True on the object.
        row: of the patch's middle.
        column: of the patch's middle.
        sigma: of the weights, in grey values.

    Returns:
        Offsets (K, 2) in pixels as (column, row), grey values (K,) and weights (K,) of sum 1; all 0 if the patch is outside the object.
    """
    steps = PATCH_SPACING * np.arange(-PATCH_REACH, PATCH_REACH + 1)
    down, across = (a.ravel() for a in np.meshgrid(steps, steps, indexing="ij"))
    r, c = np.clip(row + down, 0, grey.shape[0] - 1), np.clip(column + across, 0, grey.shape[1] - 1)
    values = grey[r, c].astype(np.float64)
    difference = np.abs(values - grey[row, column]) / sigma
    distance = (down**2 + across**2) / (PATCH_REACH * PATCH_SPACING) ** 2
    weights = np.where(inside[r, c] & (difference < WEIGHT_CUT), np.exp(-difference - 0.5 * distance), 0)
    return np.stack([across, down], -1).astype(np.float64), values, weights / max(weights.sum(), 1e-30)


def plane_homography(reference: Camera, source: Camera, pixel: np.ndarray, depth: float, normal: np.ndarray) -> np.ndarray:
    """Return the homography (3, 3) that a plane induces between two views (Hartley and Zisserman 2004, eq. 13.2).

    Args:
        reference: camera that the plane is given in.
        source: the other camera.
        pixel: (2,) point of the reference's image as (x, y), pixel centres at .5.
        depth: planar depth of the plane there.
        normal: (3,) unit normal in the reference's OpenCV axes.
    """
    inner = reference.intrinsics, source.intrinsics
    relative = source.world_to_cv @ np.linalg.inv(reference.world_to_cv)
    point = depth * (np.linalg.inv(inner[0]) @ [*pixel, 1.0])
    motion = relative[:3, :3] + np.outer(relative[:3, 3], normal) / (normal @ point)
    return inner[1] @ motion @ np.linalg.inv(inner[0])


def bilinear(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Sample an image bilinearly.

    Args:
        image: (H, W) values.
        pixels: (K, 2) points inside the outermost pixel centres, as (x, y) with pixel centres at .5.

    Returns:
        (K,) values.
    """
    whole = np.floor(pixels - 0.5).astype(int)
    (s, t), (c, r) = (pixels - 0.5 - whole).T, whole.T
    upper, lower = (image[r + k, c] * (1 - s) + image[r + k, c + 1] * s for k in (0, 1))
    return upper * (1 - t) + lower * t


def correlation_cost(first: np.ndarray, second: np.ndarray, weights: np.ndarray, brightness: float = 0.0) -> float:
    """Return 1 - NCC of two patches, in 0..2, and the cost of brightness; WORST_COST if one of them has no texture.

    Args:
        first: (K,) grey values.
        second: (K,) grey values.
        weights: (K,) of sum 1.
        brightness: cost of means that differ by BRIGHTNESS_RANGE or more, where the first patch has hardly any texture.
    """
    a, b = first - weights @ first, second - weights @ second
    variances = weights @ a**2, weights @ b**2
    if min(variances) < FLAT_VARIANCE:
        return float(WORST_COST)
    unlike = 1 - weights @ (a * b) / np.sqrt(variances[0] * variances[1])
    brightness *= WEAK_VARIANCE / (WEAK_VARIANCE + variances[0])
    return float(unlike + brightness * min(abs(weights @ (first - second)) / BRIGHTNESS_RANGE, 1))
