# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth map of a view, and the matrices that lead from its pixels to points of the world and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene.camera import GL_TO_CV, Camera


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth, normals and their evidence, found by stereo for one view.

    Attributes:
        camera: camera of the view; images are (H, W).
        depth: (H, W) float32 planar depth, world units, 0 where none was found.
        normal: (H, W, 3) float32 unit normal in world axes, towards the camera; 0 where there is no depth.
        cost: (H, W) float32 matching cost 1 - NCC in 0..2, the mean over the best sources; 2 where there is no depth.
        support: (H, W) uint8 number of witnesses whose depth and normal agree; 0 also where the cost is too high.
        witnesses: indices of the views that this one was compared with, among the views of the same estimation.
    """

    camera: Camera
    depth: np.ndarray
    normal: np.ndarray
    cost: np.ndarray
    support: np.ndarray
    witnesses: tuple[int, ...]

    def points(self) -> np.ndarray:
        """Return the points (H, W, 3) float64 of all pixels in the world; those without depth are at the camera."""
        return self.camera.centre + self.depth[..., None] * self.camera.rays().astype(np.float64)


def camera_matrices(camera: Camera) -> np.ndarray:
    """Return the projection and its inverse, (2, 3, 4) float64, for images with pixel centres at .5.

    The first maps a world point (x, y, z, 1) to (u d, v d, d) with d the planar depth; the second maps (u d, v d, d, 1) to the point.
    """
    back = (camera.to_world @ GL_TO_CV)[:3].copy()
    back[:, :3] = back[:, :3] @ np.linalg.inv(camera.intrinsics)
    return np.stack([camera.projection, back])


def cv_rotation(camera: Camera) -> np.ndarray:
    """Return the rotation (3, 3) from the camera's OpenCV axes to the world's."""
    return (camera.to_world @ GL_TO_CV)[:3, :3]
