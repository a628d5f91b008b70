# SPDX-License-Identifier: GPL-3.0-or-later
"""Pinhole camera with Blender's axes; the kernels use OpenCV's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

GL_TO_CV = np.diag([1.0, -1.0, -1.0, 1.0])
Point = Sequence[float] | np.ndarray


def look_at(eye: Point, target: Point = (0.0, 0.0, 0.0), up: Point = (0.0, 0.0, 1.0)) -> np.ndarray:
    """Return the pose (4, 4), camera to world, of a camera that looks at a point.

    Args:
        eye: (3,) position of the camera.
        target: (3,) point in the middle of the image.
        up: (3,) direction that points upwards in the image; a camera that looks along it has a world axis to its right instead.
    """
    back = np.subtract(eye, target)
    back = back / np.linalg.norm(back)
    right = np.cross(up, back)
    if np.linalg.norm(right) < 1e-9 * np.linalg.norm(up):
        side = np.abs(back).argmin()
        right = np.eye(3)[side] - back[side] * back
    right = right / np.linalg.norm(right)
    to_world = np.eye(4)
    to_world[:3] = np.stack([right, np.cross(back, right), back, eye], -1)
    return to_world


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole camera without lens distortion.

    Attributes:
        width, height: image size in pixels.
        fx, fy: focal lengths in pixels.
        cx, cy: principal point in pixels; the centre of pixel (row i, column j) is at (j + 0.5, i + 0.5).
        to_world: (4, 4) float64, rigid, camera to world; the camera looks along its -Z axis, +Y is up, +X right.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    to_world: np.ndarray

    @property
    def centre(self) -> np.ndarray:
        """Position (3,) in the world."""
        return self.to_world[:3, 3]

    @property
    def forward(self) -> np.ndarray:
        """Unit viewing direction (3,) in the world."""
        return -self.to_world[:3, 2]

    @property
    def world_to_cv(self) -> np.ndarray:
        """World to camera (4, 4) in OpenCV's axes: +X right, +Y down, +Z into the scene."""
        return GL_TO_CV @ np.linalg.inv(self.to_world)

    @property
    def intrinsics(self) -> np.ndarray:
        """Matrix (3, 3) float64 from points in OpenCV's axes to (u d, v d, d), with pixel centres at .5 and d the planar depth."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def projection(self) -> np.ndarray:
        """Matrix (3, 4) float64 from world points (x, y, z, 1) to (u d, v d, d): the intrinsics times the world's pose."""
        return self.intrinsics @ self.world_to_cv[:3]

    def rays(self) -> np.ndarray:
        """Return the rays (H, W, 3) float32 through the pixel centres in the world; centre + depth * ray is the point at a planar depth."""
        columns, rows = self.ray_parts()
        return (rows[:, None] + columns).astype(np.float32)

    def ray_parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the parts of the rays, (W, 3) of the columns and (H, 3) of the rows, float64: a pixel's ray is the sum of its two."""
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        right, up, back = self.to_world[:3, :3].T
        return x[:, None] * right, -y[:, None] * up - back

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points (N, 3).

        Returns:
            Pixel coordinates (N, 2) as (x, y), with pixel centres at .5, and planar depths (N,), > 0 in front of the camera.
        """
        to_cv = self.world_to_cv
        p = points @ to_cv[:3, :3].T + to_cv[:3, 3]
        depth = p[:, 2]
        z = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        return np.stack([p[:, 0] / z * self.fx + self.cx, p[:, 1] / z * self.fy + self.cy], -1), depth

    def in_image(self, pixel: np.ndarray, depth: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Find the projected points in front of the camera and inside its image, or hardly outside.

        Args:
            pixel: (N, 2) coordinates, as of `project`.
            depth: (N,) planar depths, as of `project`.
            margin: pixels outside the image up to which points count; inside it from which they don't, where it is negative.

        Returns:
            (N,) bool, True for these points, also where something hides them.
        """
        x, y = pixel[:, 0], pixel[:, 1]  # reductions over an axis of two are several times slower
        return (depth > 0) & (x >= -margin) & (y >= -margin) & (x < self.width + margin) & (y < self.height + margin)

    def resized(self, width: int, height: int) -> Camera:
        """Return the same camera for an image of another size.

        Args:
            width: in pixels.
            height: in pixels.
        """
        sx, sy = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy)

    def with_longest_side(self, side: int) -> Camera:
        """Return the same camera for an image whose longest side has so many pixels, and the other at least one.

        Args:
            side: in pixels, >= 1.
        """
        factor = side / max(self.width, self.height)
        return self.resized(max(1, round(self.width * factor)), max(1, round(self.height * factor)))

    def cropped(self, x: int, y: int, width: int, height: int) -> Camera:
        """Return the camera of a part of its image.

        Args:
            x: first column of the part, pixels.
            y: first row of the part, pixels.
            width: of the part, pixels.
            height: of the part, pixels.
        """
        return replace(self, width=width, height=height, cx=self.cx - x, cy=self.cy - y)

    def moved(self, similarity: np.ndarray) -> Camera:
        """Return the camera after a similarity (4, 4) of the world: its image is the same, and depths scale with the world."""
        to_world = similarity @ self.to_world
        to_world[:3, :3] /= np.cbrt(np.linalg.det(to_world[:3, :3]))
        return replace(self, to_world=to_world)
