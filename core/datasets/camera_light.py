# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that moves with the camera, such as its flash: how much brighter points are in the photographs that they face."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ..errors import InputError
from ..io.srgb import decode_srgb
from ..scene.dataset import Bound, View, light_rotations
from ..scene.triangle_tracer import TriangleTracer
from .visual_hull import visual_hull

# Slope from which a light moves with the camera. On the surface: 1.3 under a real flash, -.6 to .03 on twelve objects under a light that
# stays. On the visual hull: 1.3 under that flash, 1.0 under a rendered one in a dim room, -.31 to -.01 on ten others.
MIN_CAMERA_LIGHT = 0.5
MAX_CHANGE = 1.0  # relative change of a sample's radiance that counts at most: mirrored lights change it more
FEWEST_SAMPLES = 3  # photographs that must show a point
VIEWS = 32  # photographs that are looked at, at most
POINTS = 2000  # on the hull
HULL_CELLS = 48  # along the longest side of the hull
MIN_COSINE = 0.2  # between normal and view: the hull's points are not the surface's, least so where it is seen obliquely
OPAQUE, BRIGHTEST = 0.95, 0.97  # alpha from which a pixel shows the object, and encoded colour from which it is clipped
CLEARANCE = 2.0  # cells by which rays to the cameras start outside the hull


def with_camera_light(
    train: list[View], test: list[View], bound: Bound, light: Literal["auto", "still", "camera"], warnings: list[str]
) -> tuple[list[View], list[View], bool]:
    """Return training and test views with the rotations of a light that moves with the camera; the views themselves where it stays.

    In the world, the light is that of the first training view.

    Args:
        train: training views.
        test: test views.
        bound: bounding sphere of the object.
        light: "auto": by the photographs, where they have masks; else as it says.
        warnings: a line is appended where the photographs decide for such a light.

    Returns:
        Training views, test views, and True where their light moves with the camera.

    Raises:
        InputError: if it is "camera", and the views state themselves how the light turns.
    """
    stated = light_rotations([*train, *test]) is not None
    if light == "camera" and stated:
        raise InputError("data.light=camera", "the dataset states how the light turns", "leave the setting out")
    if light == "still" or stated:
        return train, test, False
    if light == "auto":
        slope = hull_slope(train, bound)
        if slope <= MIN_CAMERA_LIGHT:
            return train, test, False
        warnings.append(
            f"the light moves with the camera, as a flash does: points are the brighter the more they face it (slope {slope:.1f}); "
            "--set data.light=still takes it for a light that stays"
        )
    first = train[0].camera.to_world[:3, :3]
    turned = [replace(view, light_rotation=first @ view.camera.to_world[:3, :3].T) for view in (*train, *test)]
    return turned[: len(train)], turned[len(train) :], True


def radiance_slope(point: np.ndarray, radiance: np.ndarray, cosine: np.ndarray) -> float:
    """Return the slope of points' relative radiance against the cosine between normal and view; 0 where nothing is seen obliquely.

    A fixed light makes a matt point equally bright in all photographs, and a glossy one brighter in a few. A light at the camera makes it
    brighter by the cosine: the slope is 1 over the mean cosine then, 1.5 to 2.

    Args:
        point: (S,) number of each sample's point.
        radiance: (S,) linear.
        cosine: (S,).
    """
    count = np.maximum(np.bincount(point), 1)
    mean_radiance, mean_cosine = (np.bincount(point, values) / count for values in (radiance, cosine))
    change = (radiance / np.maximum(mean_radiance[point], 1e-6) - 1).clip(-MAX_CHANGE, MAX_CHANGE)
    facing = cosine - mean_cosine[point]
    return float((change * facing).sum() / max((facing**2).sum(), 1e-12))


def hull_slope(views: Sequence[View], bound: Bound) -> float:
    """Return the slope of radiance against the cosine on the visual hull; 0 where a view has no mask, or the masks contradict each other.

    Args:
        views: training views.
        bound: bounding sphere of the object.
    """
    some = views[:: max(1, -(-len(views) // VIEWS))]
    if any(view.alpha is None for view in some):
        return 0.0
    try:
        hull = visual_hull(some, bound, HULL_CELLS)
    except InputError:  # the first stage needs the hull of all views, and says what is wrong
        return 0.0
    points, normals, _ = hull.sample(POINTS, np.random.default_rng(0))
    tracer, outside = TriangleTracer(hull.triangles()), points + CLEARANCE * hull.step * normals
    parts = [_view_samples(view, points, normals, outside, tracer) for view in some]
    point, radiance, cosine = (np.concatenate(part) for part in zip(*parts, strict=True))
    often = np.bincount(point, minlength=len(points))[point] >= FEWEST_SAMPLES
    return radiance_slope(point[often], radiance[often], cosine[often])


def _view_samples(
    view: View, points: np.ndarray, normals: np.ndarray, outside: np.ndarray, tracer: TriangleTracer
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return number (S,), radiance (S,) and cosine (S,) of the points that a view shows, where it is neither clipped nor at the edge."""
    assert view.alpha is not None
    pixel, depth = view.camera.project(points)
    towards = view.camera.centre - outside
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    cosine = (towards * normals).sum(1)
    number = np.flatnonzero(view.camera.in_image(pixel, depth) & (cosine > MIN_COSINE))
    hit = tracer.closest(outside[number].astype(np.float32), towards[number].astype(np.float32))
    number = number[hit.triangle < 0]
    column, row = pixel[number].astype(int).T
    colour = view.colour[row, column]
    usable = (view.alpha[row, column] > OPAQUE) & (colour < BRIGHTEST).all(1)
    return number[usable], decode_srgb(colour[usable].astype(np.float64)).mean(1), cosine[number[usable]]
