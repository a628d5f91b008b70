# SPDX-License-Identifier: GPL-3.0-or-later
"""Images as stereo matches them: grey values with the object's mask, at full and at half resolution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..kernels.cpu.matching_cost import Sources
from ..scene.camera import Camera
from ..scene.dataset import View

OBJECT_ALPHA = 0.5  # alpha from which a pixel belongs to the object


@dataclass(frozen=True, eq=False)
class MatchingImage:
    """Image of one view.

    Attributes:
        camera: camera of the image.
        grey: (H, W) float32 grey values in 0..1, sRGB-encoded.
        inside: (H, W) bool, True on the object.
    """

    camera: Camera
    grey: np.ndarray
    inside: np.ndarray

    @property
    def lens(self) -> np.ndarray:
        """Focal lengths and principal point (4,) float32 in pixels: fx, fy, cx, cy."""
        return np.array([self.camera.fx, self.camera.fy, self.camera.cx, self.camera.cy], np.float32)

    def halved(self) -> MatchingImage:
        """Return the image at half resolution, without the last row or column of an odd size; the background does not blend in."""
        height, width = (size // 2 for size in self.grey.shape)
        camera = replace(self.camera, width=2 * width, height=2 * height).resized(width, height)
        weight = blocks(self.inside).astype(np.float32)
        coverage = weight.mean(-1)
        grey = (blocks(self.grey) * weight).mean(-1) / np.maximum(coverage, 0.25)
        return MatchingImage(camera, np.ascontiguousarray(grey, np.float32), coverage >= OBJECT_ALPHA)


def matching_image(view: View) -> MatchingImage:
    """Return the image of a view at full resolution; without alpha, all of it belongs to the object."""
    grey = cv2.cvtColor(np.ascontiguousarray(view.colour, np.float32), cv2.COLOR_RGB2GRAY)
    inside = np.ones(grey.shape, bool) if view.alpha is None else view.alpha >= OBJECT_ALPHA
    return MatchingImage(view.camera, np.clip(grey, 0, 1), inside)  # above 1 only in HDR files, whose highlights would outweigh all else


def blocks(image: np.ndarray) -> np.ndarray:
    """Return the four values of each block of 2 x 2 pixels.

    Args:
        image: (H, W) values.

    Returns:
        (H // 2, W // 2, 4) values.
    """
    height, width = (size // 2 for size in image.shape)
    return image[: 2 * height, : 2 * width].reshape(height, 2, width, 2).transpose(0, 2, 1, 3).reshape(height, width, 4)


def pack_sources(reference: MatchingImage, sources: Sequence[MatchingImage], depths: Sequence[np.ndarray] | None = None) -> Sources:
    """Pack the sources of a view for the kernels.

    Args:
        reference: image of the view.
        sources: images of its sources.
        depths: (H, W) planar depths of the sources; None where geometric consistency is not asked for.
    """
    sizes = np.array([image.grey.shape for image in sources])
    first = np.concatenate([[0], np.cumsum(sizes.prod(1))[:-1]])
    return Sources(
        pose=np.stack([_relative_pose(reference.camera, image.camera) for image in sources]),
        layout=np.column_stack([first, sizes]).astype(np.uint32),
        grey=np.concatenate([image.grey.ravel() for image in sources]),
        inside=np.concatenate([image.inside.ravel() for image in sources]),
        depth=np.zeros(1, np.float32) if depths is None else np.concatenate([depth.ravel() for depth in depths]),
    )


def _relative_pose(reference: Camera, source: Camera) -> np.ndarray:
    """Return (16,) float32: rotation and translation from the reference's OpenCV axes to the source's, then the source's intrinsics."""
    motion = source.world_to_cv @ np.linalg.inv(reference.world_to_cv)
    return np.array([*motion[:3, :3].ravel(), *motion[:3, 3], source.fx, source.fy, source.cx, source.cy], np.float32)
