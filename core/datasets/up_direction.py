# SPDX-License-Identifier: GPL-3.0-or-later
"""Up direction of a scene, estimated from the orientation in which people hold cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene.camera import Camera


def estimate_up(cameras: Sequence[Camera]) -> np.ndarray:
    """Estimate the up direction: the unit vector (3,) perpendicular to the cameras' horizontal axes, on the side of the images' tops.

    The horizontal axis of a level camera is perpendicular to the vertical however steeply the camera looks up or down, while the mean of
    the images' up axes leans towards where most cameras stand. That mean is used only where the horizontal axes determine no direction.
    """
    rights = np.stack([c.to_world[:3, 0] for c in cameras])
    mean = np.stack([c.to_world[:3, 1] for c in cameras]).mean(0)
    length = np.linalg.norm(mean)
    mean = mean / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])
    weights = np.ones(len(cameras))
    up, decided = mean, False
    for _ in range(10):  # reweighting: images in portrait orientation have their horizontal axis along the vertical
        values, vectors = np.linalg.eigh((weights[:, None, None] * rights[:, :, None] * rights[:, None, :]).sum(0) / weights.sum())
        decided = bool(values[0] < 0.3 * values[1])
        up = vectors[:, 0] * (1 if vectors[:, 0] @ mean >= 0 else -1)
        weights = 1 / np.maximum(np.abs(rights @ up), 0.05)
    return up if decided and up @ mean > 0.3 else mean


def rotation_to_z(up: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3, 3) that takes the unit vector `up` (3,) to +Z."""
    axis = np.cross(up, [0, 0, 1])
    cosine, sine2 = float(up[2]), float(axis @ axis)
    if cosine < 0 and sine2 < 1e-30:
        return np.diag([1.0, -1.0, -1.0])
    skew = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    # sin^2 / (1 - cos) equals 1 + cos without its cancellation near straight down.
    return np.eye(3) + skew + skew @ skew / (1 + cosine if cosine > 0 else sine2 / (1 - cosine))
