# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture of the support plane: what the photographs show of the table, averaged over all of them.

Cameras see the table behind the object from other sides. A pixel that shows the table's texture is not the object, even where both have
like colours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import cv2
import numpy as np

from ..machine.thread_pool import run_jobs
from ..scene.camera import Camera
from ..scene.dataset import Bound
from .support_plane import SupportPlane

REACH = 3.0  # radii of the object around it in which the texture is made
LARGEST = 768  # texels along a side
CLEAR = 0.006  # distance that a texel keeps from the object's mask, in the image's longest sides
ROUNDS = 2  # of the robust mean
NOISE = 0.06  # difference, encoded, at which a view's weight in the robust mean falls to a quarter
AT_ONCE = 8  # photographs that are in memory as texels
FEWEST = 2.0  # sum of the weights of a texel's views from which it is known


@dataclass(frozen=True, eq=False)
class PlaneTexture:
    """Colours of the support plane.

    Attributes:
        colour: (h, w, 3) float32 sRGB-encoded.
        known: (h, w) float32, 1 where enough views agree, else 0.
        frame: (4, 3) matrix from texel coordinates (column, row, 1) to the plane's homogeneous world points.
    """

    colour: np.ndarray
    known: np.ndarray
    frame: np.ndarray

    def seen_by(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Return the texture as a camera sees it: (H, W, 3) encoded, and (H, W) bool where it is known."""
        matrix, size = _projection(camera) @ self.frame, (camera.width, camera.height)
        colour = cv2.warpPerspective(self.colour, matrix, size, flags=cv2.INTER_LINEAR)
        known = cv2.warpPerspective(self.known, matrix, size, flags=cv2.INTER_LINEAR)
        return colour, (known > 0.99) & _in_front(np.linalg.inv(matrix), camera.height, camera.width)


def plane_texture(
    colours: Sequence[np.ndarray], cameras: Sequence[Camera], masks: Sequence[np.ndarray | None], plane: SupportPlane, bound: Bound
) -> PlaneTexture:
    """Average what the views show of the plane around the object.

    Texels are robust means, so that things on the table, which views see at different texels, don't count.

    Args:
        colours: (H, W, 3) float32 sRGB-encoded photographs.
        cameras: of the photographs.
        masks: (H, W) 0..1 of the object; photographs without are not used.
        plane: that the object stands on.
        bound: sphere about the object.
    """
    frame, side = _frame(cameras, plane, bound)
    jobs = [
        (np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8), _free(mask), camera, frame, side)
        for colour, mask, camera in zip(colours, masks, cameras, strict=True)
        if mask is not None
    ]
    mean = weight = np.zeros((side, side), np.float32)
    for turn in range(ROUNDS):
        total, sum_of_weights = np.zeros((side, side, 3), np.float32), np.full((side, side), 1e-6, np.float32)
        for colour, seen in chain.from_iterable(run_jobs(_on_plane, jobs[k : k + AT_ONCE]) for k in range(0, len(jobs), AT_ONCE)):
            if turn > 0:
                colour = colour * _gain(mean, colour, seen * (weight > FEWEST))
                seen = seen / (1 + np.square(colour - mean).mean(-1) / NOISE**2) ** 2
            total += seen[..., None] * colour
            sum_of_weights += seen
        mean, weight = total / sum_of_weights[..., None], sum_of_weights
    return PlaneTexture(mean, (weight > FEWEST).astype(np.float32), frame)


def _frame(cameras: Sequence[Camera], plane: SupportPlane, bound: Bound) -> tuple[np.ndarray, int]:
    """Return the texels' frame (4, 3) and their number along a side: about as large as pixels at the object."""
    centre, focal = np.asarray(bound.centre), np.median([camera.fx for camera in cameras])
    pixel = np.median([np.linalg.norm(camera.centre - centre) for camera in cameras]) / focal
    side = int(np.clip(2 * REACH * bound.radius / pixel, 64, LARGEST))
    across, along = plane.axes() * (2 * REACH * bound.radius / side)
    foot = centre - plane.height(centre) * plane.normal
    corner = foot - (across + along) * (side - 1) / 2
    return np.stack([np.append(across, 0), np.append(along, 0), np.append(corner, 1)], 1), side


def _projection(camera: Camera) -> np.ndarray:
    """Return the (3, 4) matrix from homogeneous world points to (column, row, 1) times depth, with whole numbers at pixel centres."""
    intrinsics = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1.0]])
    return intrinsics @ camera.world_to_cv[:3]


def _in_front(to_texel: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return (H, W) True for the pixels whose rays meet the plane in front of the camera."""
    # A homography's third row has the sign of the depth, which is positive at texels in front of the camera.
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    return to_texel[2, 0] * column + to_texel[2, 1] * row + to_texel[2, 2] > 0


def _free(mask: np.ndarray) -> np.ndarray:
    """Return (H, W) uint8, 255 away from the object's mask, else 0."""
    reach = 2 * max(1, round(CLEAR * max(mask.shape))) + 1
    return 255 * (cv2.dilate((mask > 0.02).astype(np.uint8), np.ones((reach, reach), np.uint8)) == 0).astype(np.uint8)


def _on_plane(colour: np.ndarray, free: np.ndarray, camera: Camera, frame: np.ndarray, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a photograph's colours (side, side, 3) float32 at the texels, and (side, side) float32, 1 where it shows them."""
    matrix = _projection(camera) @ frame
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(colour, matrix, (side, side), flags=flags).astype(np.float32) / 255
    seen = cv2.warpPerspective(free, matrix, (side, side), flags=flags)
    return warped, ((seen > 252) & _in_front(matrix, side, side)).astype(np.float32)


def _gain(mean: np.ndarray, colour: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the factors (3,) that bring a photograph's colours (h, w, 3) to the mean's where it is seen; 1 where nothing is."""
    shown = seen > 0
    if not shown.any():
        return np.ones(3, np.float32)
    return np.median(mean[shown][::16], 0) / np.maximum(np.median(colour[shown][::16], 0), 1e-3)
