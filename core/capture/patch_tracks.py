# SPDX-License-Identifier: GPL-3.0-or-later
"""Places of small surface patches in many photographs, by which poses are refined (Furukawa and Ponce 2009).

A patch is a textured pixel of a view with the plane that stereo found there. The plane says how other views show the patch; alignment
with their images says where.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np

from ..io.quantisation import eight_bits
from ..machine.thread_pool import run_reported, thread_count
from ..progress.protocol import Progress
from ..scene.camera import Camera
from ..scene.dataset import View
from ..stereo.depth_map import DepthMap
from ..stereo.patch_alignment import align_patches, sampled
from .dense_points import MIN_SUPPORT, DensePoints
from .reconstruction import Tracks

PATCHES, MAX_PATCHES = 250, 5000  # most patches of a view, and of all
RADIUS = 4  # of a patch, pixels
BORDER = RADIUS + 2  # of an image in which no patch begins, pixels
BLUR = 0.7  # of the images, pixels
APART = 0.0125  # distance between patches, longest sides of the image: 8 pixels at 640
QUALITY = 2e-3  # least texture of a patch, of that of the view's best (OpenCV's corner measure)
MAX_ANGLE = 45.0  # between the directions from which two views see a patch, degrees
MIN_COSINE = 0.25  # between a patch's normal and these directions
SAME_DEPTH = 0.03  # largest relative difference from the depth map of a view that sees a patch
MIN_CORRELATION = 0.9
MAX_SHIFT = 0.00625  # from where the poses say that a view sees a patch, widths of the image: 4 pixels at 640
MAX_DEVIATION = 0.25  # of the place, pixels
MIN_VIEWS = 2  # other views in which a patch must be found


@dataclass(frozen=True, eq=False)
class _Patches:
    """N patches of one view: centres (N, 2) in its image, M samples on the surface (N, M, 3), normals (N, 3), values (N, M)."""

    centre: np.ndarray
    surface: np.ndarray
    normal: np.ndarray
    values: np.ndarray

    @property
    def position(self) -> np.ndarray:
        return self.surface[:, self.surface.shape[1] // 2]

    def select(self, keep: np.ndarray) -> _Patches:
        return _Patches(self.centre[keep], self.surface[keep], self.normal[keep], self.values[keep])


def find_patch_tracks(views: Sequence[View], dense: DensePoints, background: Mapping[str, np.ndarray], progress: Progress) -> Tracks:
    """Find textured patches of surface in the photographs.

    Args:
        views: V undistorted photographs.
        dense: their depth maps.
        background: (H, W) bool by the view's name, True where no patch may begin: the static background of a turntable.
        progress: receives the phase "refine poses", and may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    progress.phase("refine poses", len(dense.chosen))
    images = [cv2.GaussianBlur(cv2.cvtColor(view.colour.astype(np.float32), cv2.COLOR_RGB2GRAY), (0, 0), BLUR) for view in views]
    maps = dict(zip(dense.chosen, dense.maps, strict=True))
    count = min(PATCHES, MAX_PATCHES // len(dense.chosen))

    def tracks(i: int) -> Tracks:
        patches = _patches(views[i], images[i], maps[i], background.get(views[i].name), count)
        return _tracks(i, patches, views, images, maps)

    return reduce(Tracks.joined, run_reported(tracks, dense.chosen, thread_count(), progress, "stopped while poses were refined"))


def _patches(view: View, image: np.ndarray, depth_map: DepthMap, background: np.ndarray | None, count: int) -> _Patches:
    """Return the most textured patches of a view, apart from each other, where stereo found a surface."""
    height, width = image.shape
    usable = cv2.resize((depth_map.support >= MIN_SUPPORT).astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    usable[:BORDER] = usable[-BORDER:] = usable[:, :BORDER] = usable[:, -BORDER:] = 0
    if background is not None:
        usable[background] = 0
    corners = cv2.goodFeaturesToTrack(image, count, QUALITY, APART * max(height, width), mask=usable, blockSize=2 * RADIUS + 1)
    centre = np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2) + 0.5
    beside = np.arange(-RADIUS, RADIUS + 1, dtype=np.float64)
    places = centre[:, None] + np.stack(np.meshgrid(beside, beside), -1).reshape(1, -1, 2)
    surface, normal, seen = _on_planes(view.camera, depth_map, centre, places)
    return _Patches(centre, surface, normal, sampled(image, places)).select(seen)


def _on_planes(camera: Camera, depth_map: DepthMap, centre: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the points (N, M, 3) that places show of the planes at centres (N, 2), normals (N, 3), and which (N,) face the view."""
    small = depth_map.camera
    column = np.minimum(centre[:, 0] * small.width / camera.width, small.width - 1).astype(int)
    row = np.minimum(centre[:, 1] * small.height / camera.height, small.height - 1).astype(int)
    normal = depth_map.normal[row, column].astype(np.float64)
    offset = np.einsum("nc,nc->n", depth_map.points()[row, column] - camera.centre, normal)
    x, y = (places[..., 0] - camera.cx) / camera.fx, (places[..., 1] - camera.cy) / camera.fy
    rays = np.stack([x, -y, -np.ones_like(x)], -1) @ camera.to_world[:3, :3].T
    slope = np.einsum("nmc,nc->nm", rays, normal)
    depth = offset[:, None] / np.where(np.abs(slope) > 1e-9, slope, 1e-9)
    middle = rays[:, rays.shape[1] // 2]
    facing = -np.einsum("nc,nc->n", normal, middle) / np.linalg.norm(middle, axis=-1)
    return camera.centre + depth[..., None] * rays, normal, (depth > 0).all(1) & (facing > MIN_COSINE)


def _tracks(i: int, patches: _Patches, views: Sequence[View], images: Sequence[np.ndarray], maps: Mapping[int, DepthMap]) -> Tracks:
    """Return the tracks of the patches of view i."""
    point, view, pixel = [np.arange(len(patches.centre))], [np.full(len(patches.centre), i)], [patches.centre]
    for j, other in enumerate(views):
        if j == i or not len(patches.centre):
            continue
        rows = np.flatnonzero(_visible(patches, views[i].camera, other.camera, maps.get(j)))
        there, places = _found(patches.select(rows), other.camera, images[j])
        point.append(rows[there])
        view.append(np.full(int(there.sum()), j))
        pixel.append(places[there])
    points, photograph = (np.concatenate(part).astype(np.int32) for part in (point, view))
    column, row = patches.centre.astype(int).T
    found = Tracks(patches.position, eight_bits(views[i].colour[row, column]), points, photograph, np.concatenate(pixel))
    return found.select(np.bincount(points, minlength=len(patches.centre)) > MIN_VIEWS)


def _visible(patches: _Patches, camera: Camera, other: Camera, depth_map: DepthMap | None) -> np.ndarray:
    """Return which patches (N,) another camera sees from a similar direction, and not behind what its depth map shows."""
    to_one, to_other = (patches.position - one.centre for one in (camera, other))
    to_one, to_other = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in (to_one, to_other))
    similar = np.sum(to_one * to_other, 1) > np.cos(np.radians(MAX_ANGLE))
    facing = -np.sum(to_other * patches.normal, 1) > MIN_COSINE
    pixel, depth = other.project(patches.surface.reshape(-1, 3))
    inside = other.in_image(pixel, depth, -2.0).reshape(len(facing), -1).all(1)
    seen = similar & facing & inside
    if depth_map is None or not seen.any():
        return seen
    pixel, depth = depth_map.camera.project(patches.position[seen])
    column, row = pixel.astype(int).T
    there = np.where(depth_map.support[row, column] >= MIN_SUPPORT, depth_map.depth[row, column], depth)
    seen[seen] = np.abs(there / depth - 1) < SAME_DEPTH
    return seen


def _found(patches: _Patches, camera: Camera, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Align patches with the image of another view; return which are found (N,), and their places (N, 2)."""
    count, samples = patches.values.shape
    places = camera.project(patches.surface.reshape(-1, 3))[0].reshape(count, samples, 2)
    fit = align_patches(image, places, patches.values)
    near = np.linalg.norm(fit.shift, axis=1) < MAX_SHIFT * camera.width
    good = (fit.correlation > MIN_CORRELATION) & (fit.deviation < MAX_DEVIATION) & fit.settled & near
    return good, places[:, samples // 2] + fit.shift
