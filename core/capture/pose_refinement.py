# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses and focal lengths refined on patches of surface that stereo found (Furukawa and Ponce 2009).

Features are few where surfaces have little texture, and each is exact to about half a pixel. Patches are many and exact to a tenth. The
refined poses are taken where patches that had no part in them fit clearly better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from ..datasets.bound import find_look_at_point
from ..datasets.parsed_dataset import Lens
from ..errors import Cancelled
from ..progress.protocol import Progress
from ..scene.camera import GL_TO_CV, Camera
from ..scene.dataset import PointCloud
from .dense_points import DensePoints, find_dense_points
from .mapping import Freedom, refine_robustly
from .patch_tracks import find_patch_tracks
from .reconstruction import Tracks, build_reconstruction
from .sparse_model import SparseModel
from .undistortion import UndistortedImage, distorted_pixels, undistorted_pixels

ROUNDS = 2  # of stereo and adjustment; the second only where the first moved the poses
MOVED = 0.25  # median shift of the look-at point beyond which stereo is repeated, pixels at 640 a side
HELD_BACK = 8  # every patch of so many judges the refinement and has no part in it
# Largest ratio of the judges' errors after and before at which the refined poses are taken. It was .67 to .966 for seven captures, whose
# poses became better by truth, and .98 and .99 for two datasets of small masked images whose cameras are exact.
MAX_ERROR_RATIO = 0.97
MIN_PATCHES = 100  # below, the poses stay
ROBUST_SCALE = 0.3  # pixels of error at which the adjustment begins to distrust a place
ADJUSTMENTS = 3  # in a row; the work can be stopped between two
MAX_FOCAL_CHANGE = 1.05  # factor beyond which the patches do not tell the focal length, and it stays


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """Posed photographs after the refinement.

    Attributes:
        model: sparse model, whose points are joined by the patches.
        images: undistorted images of `model.posed`, with their cameras.
        dense: dense points that fit these cameras; None where they have to be found again.
    """

    model: SparseModel
    images: list[UndistortedImage]
    dense: DensePoints | None


@dataclass(frozen=True, eq=False)
class _Adjustment:
    """Cameras and tracks after an adjustment; in pixels of the views, mean error of places, and median of the judges before and after."""

    cameras: list[Camera]
    tracks: Tracks
    error: float
    before: float = np.inf
    after: float = np.inf


def refine_poses(
    model: SparseModel, images: Sequence[UndistortedImage], background: Mapping[str, np.ndarray], seed: int, progress: Progress
) -> RefinedPoses:
    """Refine the poses and focal lengths of photographs.

    Args:
        model: as found; cameras that a dataset gives are kept.
        images: undistorted images of `model.posed`.
        background: (H, W) bool by the view's name, True where the static background of a turntable is seen.
        seed: seed of stereo's random numbers.
        progress: receives the phases "dense points" and "refine poses" and a message, and may cancel.

    Raises:
        Cancelled: the user stopped the work.
    """
    if model.has_given_cameras:
        return RefinedPoses(model, list(images), None)
    cameras, features = [one.view.camera for one in images], _features(model, images)
    freedom = Freedom.FIXED if any(one.posed.lens.fisheye for one in images) else Freedom.FULL
    found, dense = [], None
    for _ in range(ROUNDS):
        views = [replace(one.view, camera=camera) for one, camera in zip(images, cameras, strict=True)]
        points = PointCloud(features.position.astype(np.float32), features.colour.astype(np.float32) / 255)
        dense = find_dense_points(views, points, None, seed, progress)
        better = _judged(cameras, features, find_patch_tracks(views, dense, background, progress), freedom, progress)
        if better is None:
            break
        found.append(better)
        moved, cameras = _shift(cameras, better.cameras), better.cameras
        features = better.tracks.select(np.arange(len(better.tracks.position)) < len(features.position))
        if moved < MOVED:
            break
        dense = None
    if not found:
        progress.message("poses: patches of surface fit hardly better after a refinement, so they stay as they are")
        return RefinedPoses(model, list(images), dense)
    count, before, after = len(found[-1].tracks.position) - len(features.position), found[0].before, found[-1].after
    progress.message(f"poses: refined on {count} patches of surface; others fit to {after:.2f} pixels, to {before:.2f} before")
    return RefinedPoses(*_with_adjustment(model, images, found[-1]), dense)


def _judged(cameras: Sequence[Camera], features: Tracks, patches: Tracks, freedom: Freedom, progress: Progress) -> _Adjustment | None:
    """Return the adjustment to features and most patches; None where there are too few, or the other patches fit hardly better after it."""
    judges = np.arange(len(patches.position)) % HELD_BACK == 0
    if len(judges) < MIN_PATCHES:
        return None
    found = _adjusted(cameras, features.joined(patches.select(~judges)), freedom, progress)
    before, after = (track_error(each, patches.select(judges)) for each in (cameras, found.cameras))
    return replace(found, before=before, after=after) if after <= MAX_ERROR_RATIO * before else None


def _features(model: SparseModel, images: Sequence[UndistortedImage]) -> Tracks:
    """Return the tracks of a sparse model in the pixels of the reduced undistorted views."""
    pixel = np.zeros((len(model.track_pixel), 2))
    for i, one in enumerate(images):
        own = model.track_photograph == i
        pixel[own] = undistorted_pixels(model.track_pixel[own], one.posed.lens) / _full_scale(one)
    return Tracks(model.position, model.colour, model.track_point, model.track_photograph, pixel)


def _full_scale(image: UndistortedImage) -> np.ndarray:
    """Return the factors (2,) of x and y from places in the view to places in the full-size image."""
    view = image.view.camera
    return np.array([image.camera.width / view.width, image.camera.height / view.height])


def _adjusted(cameras: Sequence[Camera], tracks: Tracks, freedom: Freedom, progress: Progress) -> _Adjustment:
    """Adjust cameras and points to the tracks, in the frame of the cameras before.

    Raises:
        Cancelled: the user stopped the work.
    """
    model = build_reconstruction([str(i) for i in range(len(cameras))], cameras, tracks)
    for _ in range(ADJUSTMENTS):
        refine_robustly(model, freedom, ROBUST_SCALE)
        if progress.cancelled:
            raise Cancelled("stopped while poses were refined")
    moved = [_moved_camera(camera, model, i + 1) for i, camera in enumerate(cameras)]
    if any(abs(np.log(new.fx / old.fx)) > np.log(MAX_FOCAL_CHANGE) for old, new in zip(cameras, moved, strict=True)):
        return _adjusted(cameras, tracks, Freedom.FIXED, progress)
    back = pycolmap.estimate_sim3d(*(np.array([camera.centre for camera in each]) for each in (moved, cameras)))
    if back is not None:  # else the cameras' places lie on a line, and tell no frame
        model.transform(back)
    moved = [_moved_camera(camera, model, i + 1) for i, camera in enumerate(cameras)]
    position = np.array([model.point3D(number).xyz for number in sorted(model.point3D_ids())])
    return _Adjustment(moved, replace(tracks, position=position), float(model.compute_mean_reprojection_error()))


def _moved_camera(camera: Camera, model: pycolmap.Reconstruction, number: int) -> Camera:
    """Return a camera with the pose and the focal lengths of an image of COLMAP's model."""
    image, to_camera = model.image(number), np.eye(4)
    to_camera[:3] = image.cam_from_world().matrix()
    lens = model.camera(image.camera_id)
    return replace(camera, fx=lens.focal_length_x, fy=lens.focal_length_y, to_world=np.linalg.inv(to_camera) @ GL_TO_CV)


def track_error(cameras: Sequence[Camera], tracks: Tracks) -> float:
    """Return the median distance in pixels between places and the points that fit their rays best.

    Args:
        cameras: of the V photographs.
        tracks: each point with two places or more; their positions are not used.
    """
    centre, ray = np.zeros((2, len(tracks.point), 3))
    for i, camera in enumerate(cameras):
        own = tracks.photograph == i
        x, y = ((tracks.pixel[own] - [camera.cx, camera.cy]) / [camera.fx, camera.fy]).T
        centre[own], ray[own] = camera.centre, np.stack([x, -y, -np.ones_like(x)], -1) @ camera.to_world[:3, :3].T
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    across = np.eye(3) - ray[:, :, None] * ray[:, None]  # projections onto the planes across the rays
    normal, right = np.zeros((len(tracks.position), 3, 3)), np.zeros((len(tracks.position), 3))
    np.add.at(normal, tracks.point, across)
    np.add.at(right, tracks.point, np.einsum("tij,tj->ti", across, centre))
    points = np.linalg.solve(normal, right[..., None])[..., 0][tracks.point]
    error = np.zeros(len(points))
    for i, camera in enumerate(cameras):
        own = tracks.photograph == i
        error[own] = np.linalg.norm(camera.project(points[own])[0] - tracks.pixel[own], axis=1)
    return float(np.median(error))


def _shift(before: Sequence[Camera], after: Sequence[Camera]) -> float:
    """Return the median distance between the places of the look-at point with two sets of cameras, pixels at 640 a side."""
    target = find_look_at_point(before).point[None]
    shift = [np.linalg.norm(new.project(target)[0] - old.project(target)[0]) for old, new in zip(before, after, strict=True)]
    return float(np.median(shift)) * 640 / max(before[0].width, before[0].height)


def _with_adjustment(
    model: SparseModel, images: Sequence[UndistortedImage], found: _Adjustment
) -> tuple[SparseModel, list[UndistortedImage]]:
    """Return a sparse model and its images with adjusted cameras, and the model's points joined by the patches."""
    moved = [_with_camera(one, camera) for one, camera in zip(images, found.cameras, strict=True)]
    added = found.tracks.point >= len(model.position)
    pixel, photograph = found.tracks.pixel[added], found.tracks.photograph[added]
    for i, one in enumerate(images):
        own = photograph == i
        pixel[own] = distorted_pixels(pixel[own] * _full_scale(one), one.posed.lens)
    joined = replace(
        model,
        posed=[one.posed for one in moved],
        position=found.tracks.position,
        colour=found.tracks.colour,
        track_point=np.concatenate([model.track_point, found.tracks.point[added]]),
        track_photograph=np.concatenate([model.track_photograph, photograph]),
        track_pixel=np.concatenate([model.track_pixel, pixel.astype(np.float32)]),
        error=found.error * float(np.median([_full_scale(one) for one in images])),
    )
    return joined, moved


def _with_camera(image: UndistortedImage, camera: Camera) -> UndistortedImage:
    """Return an undistorted image with a refined camera (of its view)."""
    x, y = camera.fx / image.view.camera.fx, camera.fy / image.view.camera.fy
    posed = replace(image.posed, lens=lens_of_focal_change(image.posed.lens, x, y), to_world=camera.to_world)
    full = replace(image.camera, fx=image.camera.fx * x, fy=image.camera.fy * y, to_world=camera.to_world)
    return replace(image, posed=posed, camera=full, view=replace(image.view, camera=camera))


def lens_of_focal_change(lens: Lens, x: float, y: float) -> Lens:
    """Return the lens whose undistorted image is the same, but taken for one of other focal lengths.

    With rays p' = p / s for s times the focal length, fx p (1 + k1 p^2 + ...) is s fx p' (1 + k1 s^2 p'^2 + ...).

    Args:
        lens: of Brown's model; a fisheye has to keep its focal length.
        x: factor of the horizontal focal length.
        y: factor of the vertical one, nearly the same.
    """
    scale = np.sqrt(x * y)
    powers = (2, 4, 1, 1, 6)  # of k1, k2, p1, p2, k3
    distortion = tuple(float(k * scale**power) for k, power in zip(lens.distortion, powers, strict=False))
    return replace(lens, fx=lens.fx * x, fy=lens.fy * y, distortion=lens.distortion if lens.fisheye else distortion)
