# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's model of pinhole cameras and points, built from arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap

from ..scene.camera import Camera


@dataclass(frozen=True, eq=False)
class Tracks:
    """P points and the T places where V photographs show them.

    Attributes:
        position: (P, 3) float64 in the cameras' frame.
        colour: (P, 3) uint8 sRGB.
        point, photograph: (T,) int32, the point and the index of the photograph of each place.
        pixel: (T, 2) float64 place, pixel centres at .5.
    """

    position: np.ndarray
    colour: np.ndarray
    point: np.ndarray
    photograph: np.ndarray
    pixel: np.ndarray

    def joined(self, other: Tracks) -> Tracks:
        """Return these points, followed by others."""
        moved = Tracks(other.position, other.colour, other.point + np.int32(len(self.position)), other.photograph, other.pixel)
        return Tracks(*(np.concatenate(pair) for pair in zip(vars(self).values(), vars(moved).values(), strict=True)))

    def select(self, keep: np.ndarray) -> Tracks:
        """Return the points where `keep` (P,) is True, with their places."""
        number, places = np.cumsum(keep) - 1, keep[self.point]
        point = number[self.point[places]].astype(np.int32)
        return Tracks(self.position[keep], self.colour[keep], point, self.photograph[places], self.pixel[places])


def build_reconstruction(names: Sequence[str], cameras: Sequence[Camera], tracks: Tracks) -> pycolmap.Reconstruction:
    """Return COLMAP's model of photographs; image i + 1 is photograph i, and equal intrinsics are one camera.

    Args:
        names: of the V photographs.
        cameras: V pinhole cameras.
        tracks: points in their frame.
    """
    reconstruction = pycolmap.Reconstruction()
    numbers: dict[tuple[float, ...], int] = {}
    order = np.lexsort((tracks.point, tracks.photograph))
    starts = np.searchsorted(tracks.photograph[order], np.arange(len(cameras) + 1))
    elements: list[list[pycolmap.TrackElement]] = [[] for _ in tracks.position]
    for i, (name, camera) in enumerate(zip(names, cameras, strict=True)):
        places = order[starts[i] : starts[i + 1]]
        number = _camera_number(reconstruction, numbers, camera)
        image = pycolmap.Image(name=name, keypoints=tracks.pixel[places], camera_id=number, image_id=i + 1)
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera.world_to_cv[:3]))
        for j, point in enumerate(tracks.point[places]):
            elements[point].append(pycolmap.TrackElement(i + 1, j))
    for place, colour, seen in zip(tracks.position, tracks.colour, elements, strict=True):
        reconstruction.add_point3D(place, pycolmap.Track(seen), colour)
    return reconstruction


def _camera_number(reconstruction: pycolmap.Reconstruction, numbers: dict[tuple[float, ...], int], camera: Camera) -> int:
    """Return the number of a pinhole camera in the reconstruction, which is added where it is new."""
    key = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    if key not in numbers:
        numbers[key] = len(numbers) + 1
        added = pycolmap.Camera(
            camera_id=numbers[key], model="PINHOLE", width=camera.width, height=camera.height, params=np.array(key[2:], np.float64)
        )
        reconstruction.add_camera_with_trivial_rig(added)
    return numbers[key]
