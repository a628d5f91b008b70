# SPDX-License-Identifier: GPL-3.0-or-later
"""Sphere by which a person chooses the object of a capture: its settings, its checks, and the spheres of other things to choose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..scene.camera import Camera
from ..scene.dataset import Bound
from ..settings.schema import CaptureSettings

WHERE = "the object's sphere (capture.centre, capture.radius)"
MIN_VIEWS = 3  # photographs that must show the sphere, as many as must get a mask
MAX_INSIDE = 0.1  # fraction of the cameras that may be inside, as for every bound
SHOWN = 5  # other things whose spheres are listed


def chosen_sphere(settings: CaptureSettings) -> Bound | None:
    """Return the sphere of the settings, in the frame of the written dataset; None where the object is found by itself.

    Raises:
        InputError: if only one of centre and radius is given.
    """
    if settings.centre is None and settings.radius is None:
        return None
    if settings.centre is None or settings.radius is None:
        given, missing = ("capture.radius", "capture.centre") if settings.centre is None else ("capture.centre", "capture.radius")
        raise InputError(given, f"is given without {missing}", "give both, or neither to find the object by itself")
    x, y, z = (float(value) for value in settings.centre)
    return Bound((x, y, z), float(settings.radius))


def check_sphere(sphere: Bound, cameras: Sequence[Camera]) -> None:
    """Check that photographs show a sphere from outside.

    Args:
        sphere: the sphere, in the cameras' frame.
        cameras: cameras of all photographs.

    Raises:
        InputError: if fewer than MIN_VIEWS photographs show any of it, or many cameras are inside.
    """
    centre = np.asarray(sphere.centre)
    places = np.concatenate([centre[None], *(centre + sign * sphere.radius * np.eye(3) for sign in (-1, 1))])
    seen = sum(bool(camera.in_image(*camera.project(places)).any()) for camera in cameras)
    if seen < MIN_VIEWS:
        raise InputError(WHERE, f"is shown by {seen} of {len(cameras)} photographs", "move it to where the cameras look")
    inside = sum(float(np.linalg.norm(camera.centre - centre)) < sphere.radius for camera in cameras)
    if inside > MAX_INSIDE * len(cameras):
        raise InputError(WHERE, f"has {inside} of {len(cameras)} cameras inside", "make it smaller")


def check_points(sphere: Bound, points: Sequence[np.ndarray]) -> None:
    """Raise InputError where a sphere holds none of the points, given as arrays (N, 3) in its frame."""
    centre = np.asarray(sphere.centre)
    if not any((np.linalg.norm(some - centre, axis=1) < sphere.radius).any() for some in points):
        raise InputError(WHERE, "holds no point of the scene", "move it onto the object, or make it larger")


def other_things(others: Sequence[Bound]) -> list[str]:
    """Return a line about things near the object that the masks leave out, and how to choose one of them; none without any.

    Args:
        others: their bounding spheres in the frame of the written dataset, the largest first.
    """
    if not others:
        return []
    what = "1 other thing" if len(others) == 1 else f"{len(others)} other things"
    more = f" and {len(others) - SHOWN} more" if len(others) > SHOWN else ""
    spheres = ", ".join(" ".join(_decimal(value) for value in (*one.centre, one.radius)) for one in others[:SHOWN])
    choose = "one of them is chosen by capturing again with --sphere and these numbers, or by moving the sphere in Blender"
    return [f"masks: {what} near the object left out, at X Y Z RADIUS {spheres}{more}; {choose}"]


def _decimal(value: float) -> str:
    """Write a number without an exponent, which the command line would not take after a minus."""
    return np.format_float_positional(value, 4, fractional=False, trim="-")
