# SPDX-License-Identifier: GPL-3.0-or-later
"""From the frame that photographs were solved in to our world: upright, with the object at the origin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..scene.camera import Camera
from ..scene.dataset import PointCloud
from .bound import bound_of_cameras, bound_of_points
from .parsed_dataset import Frame, ParsedDataset
from .up_direction import rotation_to_z, up_of


def settle(
    source: Path, root: Path, format: str, frames: list[Frame], points: PointCloud | None, warnings: list[str], upright: bool = False
) -> ParsedDataset:
    """Frames and points of a solver's own frame as a capture in our world; its scale is kept.

    The cameras' up becomes +Z, unless the solver's world is `upright` already; the object is moved to the origin. Both depend on cameras
    and points alone, so that every command that reads the dataset finds the same world.
    """
    cameras = [rough_camera(f) for f in frames]
    position = np.empty((0, 3)) if points is None else points.position.astype(np.float64)
    bound = bound_of_points(cameras, position) or bound_of_cameras(cameras)
    to_world = np.eye(4)
    if not upright:
        to_world[:3, :3] = rotation_to_z(up_of(cameras))
    to_world[:3, 3] = -to_world[:3, :3] @ np.array(bound.centre)
    return moved(
        ParsedDataset(source, root, format, frames, None, np.eye(4), points if len(position) else None, warnings=warnings), to_world
    )


def moved(capture: ParsedDataset, to_world: np.ndarray) -> ParsedDataset:
    """The capture, so far in the dataset's own frame and without a bound, after a similarity (4, 4) to our world."""

    def placed(frames: list[Frame]) -> list[Frame]:
        return [replace(f, to_world=rough_camera(f).moved(to_world).to_world) for f in frames]

    points = capture.points
    if points is not None:
        position = points.position.astype(np.float64) @ to_world[:3, :3].T + to_world[:3, 3]
        points = PointCloud(position.astype(np.float32), points.colour)
    test = None if capture.test is None else placed(capture.test)
    whole = to_world @ capture.to_world
    return replace(capture, train=placed(capture.train), test=test, novel=placed(capture.novel), to_world=whole, points=points)


def rough_camera(frame: Frame) -> Camera:
    """The frame's camera without its lens distortion: good enough to say what it looks at."""
    lens = frame.lens
    return Camera(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, frame.to_world)
