# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs whose poses too few points fix: mostly something in front hides what the other photographs show.

Such a pose errs by more than its points do: of four photographs with 37 to 60 points in four captures, three showed the object .7 to 3.2
pixels beside its place, all others .2 at most. The mask of a hidden part is wrong, too. A reconstruction is better off without them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..datasets.bound import find_look_at_point
from ..datasets.undistort import pinhole
from ..scene.camera import Camera
from .photograph import LeftOut
from .sparse_model import PosedPhotograph, SparseModel

# Standard deviation of the look-at point's place in a photograph from which its pose is uncertain, pixels at 640 a side, and in medians of
# all photographs. In six captures it was .14 to .47 for the four photographs in which a cloth hides the object, .07 at most for the
# others, and .02 to .04 in the median.
MAX_DEVIATION, MAX_MEDIANS = 0.1, 4.0
MAX_FRACTION = 0.1  # fraction of the photographs; where more are uncertain, the scene has few points, and none is left out
# Pixels by which masks may be wrong for each of the median deviation. Six captures with 690 to 1,285 points a photograph have deviations
# of .02 to .04, two with 61 and 64 points .18 and .08: their tables are plain, and colours alone tell thin parts of the object from them.
WIDENING_FACTOR = 10.0
MAX_WIDENING = 3  # pixels, of that
MEAN_TO_DEVIATION = 0.8  # standard deviation of an error along an axis over the mean length of errors in the plane


def without_uncertain_poses(model: SparseModel) -> SparseModel:
    """Return a model without the photographs whose poses too few points fix.

    Args:
        model: as found; one whose cameras a dataset gives is returned as it is.
    """
    if model.has_given_cameras:
        return model
    deviation = place_deviations(model)
    uncertain = deviation > max(MAX_DEVIATION, MAX_MEDIANS * float(np.median(deviation)))
    if not uncertain.any() or uncertain.mean() > MAX_FRACTION:
        return model
    points = np.bincount(model.track_photograph, minlength=len(model.posed))
    reasons = [LeftOut(model.posed[i].photograph.name, _reason(int(points[i]))) for i in np.flatnonzero(uncertain)]
    kept = model.subset(np.flatnonzero(~uncertain).tolist())
    return replace(kept, left_out=[*kept.left_out, *reasons])


def mask_widening(model: SparseModel) -> int:
    """Return the pixels, at 640 a side, by which masks may be wrong, rounded; 0 for given cameras.

    Few features fix the cameras where the surroundings have little texture, and there masks rest on colours alone.

    Args:
        model: of features, with observations.
    """
    return 0 if model.has_given_cameras else round(min(WIDENING_FACTOR * float(np.median(place_deviations(model))), MAX_WIDENING))


def place_deviations(model: SparseModel) -> np.ndarray:
    """Return the standard deviation (N,) of the place at which each photograph shows the look-at point, pixels at 640 a side.

    The errors of a photograph's points are taken as independent, and the points as known exactly. A photograph with fewer than 3 points has
    an infinite one.

    Args:
        model: with observations.
    """
    cameras = [_camera(one) for one in model.posed]
    target = find_look_at_point(cameras).point
    noise = MEAN_TO_DEVIATION * (model.error or 0.0)
    found = []
    for i, camera in enumerate(cameras):
        points = model.position[model.track_point[model.track_photograph == i]]
        found.append(noise * 640 / max(camera.width, camera.height) * _place_deviation(camera, points, target))
    return np.array(found)


def _place_deviation(camera: Camera, points: np.ndarray, target: np.ndarray) -> float:
    """Return the standard deviation of a target's (3,) place in pixels, for one of a pixel in those of points (P, 3) that fix the pose."""
    rows = _pose_derivatives(camera, points).reshape(-1, 6)
    information = rows.T @ rows
    if len(points) < 3 or np.linalg.matrix_rank(information) < 6:
        return np.inf
    shift = _pose_derivatives(camera, target[None])[0]
    return float(np.sqrt(np.trace(shift @ np.linalg.solve(information, shift.T))))


def _pose_derivatives(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Return the derivatives (P, 2, 6) of the pixels of points (P, 3) by a turn of the camera's frame and by a shift of it."""
    to_camera = camera.world_to_cv
    seen = points @ to_camera[:3, :3].T + to_camera[:3, 3]
    x, y, z = seen.T
    none = np.zeros_like(z)
    along_x = np.stack([camera.fx / z, none, -camera.fx * x / z**2], 1)
    along_y = np.stack([none, camera.fy / z, -camera.fy * y / z**2], 1)
    return np.stack([np.concatenate([np.cross(seen, along), along], 1) for along in (along_x, along_y)], 1)


def _camera(one: PosedPhotograph) -> Camera:
    plain = pinhole(one.lens)
    return Camera(plain.width, plain.height, plain.fx, plain.fy, plain.cx, plain.cy, one.to_world)


def _reason(points: int) -> str:
    return f"uncertain pose: only {points} points show from where it was taken; something may stand in front of the object"
