# SPDX-License-Identifier: GPL-3.0-or-later
"""Static background of a turntable in the undistorted images, and the turns of the light about the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..datasets.undistort import undistort_mask
from .photograph import Photograph
from .turntable import Turntable
from .undistortion import UndistortedImage

MARGIN = 5  # pixels of the compared images around what moves in which nothing is certain


@dataclass(frozen=True, eq=False)
class SeenBackground:
    """What the static background tells of V undistorted images.

    Attributes:
        masks: (H, W) bool by the view's name, True where the background is seen.
        gains: (V, 3) linear exposure gains of the images.
    """

    masks: dict[str, np.ndarray]
    gains: np.ndarray

    @classmethod
    def of(cls, turntable: Turntable, photographs: Sequence[Photograph], images: Sequence[UndistortedImage]) -> SeenBackground:
        """Select and undistort what belongs to the registered photographs.

        Args:
            turntable: static pixels and gains of all photographs.
            photographs: photographs in the order of the turntable's.
            images: undistorted images of those that have a pose.
        """
        number = {one.name: i for i, one in enumerate(photographs)}
        chosen = [number[one.posed.photograph.name] for one in images]
        masks = {one.view.name: _background(turntable.moving[i], one) for i, one in zip(chosen, images, strict=True)}
        return cls(masks, turntable.gains[chosen])


def _background(moving: np.ndarray, image: UndistortedImage) -> np.ndarray:
    """Return where an undistorted view shows the background, (H, W) bool, from what moves (h, w) in its photograph."""
    height, width = moving.shape
    near = cv2.dilate(moving.astype(np.uint8), np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8))
    still = undistort_mask(1 - near.astype(np.float32), image.posed.lens.resized(width, height))
    size = image.view.camera.width, image.view.camera.height
    return cv2.resize(still.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.99


def light_rotations(images: Sequence[UndistortedImage], similarity: np.ndarray) -> dict[str, list[list[float]]]:
    """Return the rotation from the world to the frame of the light, by the view's name.

    The light stands still in the frame of the fixed camera. Its own frame is the world as it was at the first photograph, so that the
    rotation of view i is C_1 C_i^T with the cameras' rotations C.

    Args:
        images: undistorted images with their cameras in the model's frame.
        similarity: (4, 4) from the model's frame to the world.
    """
    turned = [one.camera.moved(similarity).to_world[:3, :3] for one in images]
    return {one.view.name: (turned[0] @ rotation.T).tolist() for one, rotation in zip(images, turned, strict=True)}
