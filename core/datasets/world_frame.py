# SPDX-License-Identifier: GPL-3.0-or-later
"""Normalisation of the world frame: from the frame of a structure-from-motion solver to +Z up, with the object at the origin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..scene.camera import Camera
from ..scene.dataset import PointCloud
from .bound import bound_of_cameras, bound_of_points
from .parsed_dataset import Frame, ParsedDataset
from .up_direction import estimate_up, rotation_to_z


def normalise_world_frame(
    source: Path, root: Path, format: str, frames: list[Frame], points: PointCloud | None, warnings: list[str], upright: bool = False
) -> ParsedDataset:
    """Rotate and move a solver's frame to the world: the cameras' up becomes +Z and the object's centre the origin; the scale is kept.

    Both depend on cameras and points alone, so that every command that reads the dataset finds the same world.

    Args:
        source: the file or model folder that was read.
        root: the folder that contains every image.
        format: short name of the format.
        frames: frames in the solver's frame.
        points: sparse points in the solver's frame, or None.
        warnings: warnings so far.
        upright: the solver's frame has +Z up already, and is only moved.
    """
    cameras = [approximate_camera(f) for f in frames]
    position = np.empty((0, 3)) if points is None else points.position.astype(np.float64)
    bound = bound_of_points(cameras, position) or bound_of_cameras(cameras)
    to_world = np.eye(4)
    if not upright:
        to_world[:3, :3] = rotation_to_z(estimate_up(cameras))
    to_world[:3, 3] = -to_world[:3, :3] @ np.array(bound.centre)
    return transform_world(
        ParsedDataset(source, root, format, frames, None, np.eye(4), points if len(position) else None, warnings=warnings), to_world
    )


def transform_world(parsed: ParsedDataset, to_world: np.ndarray) -> ParsedDataset:
    """Transform the frames and points of a dataset.

    Args:
        parsed: the dataset, in its own frame and without a bound.
        to_world: (4, 4) similarity from its frame to the world.
    """
    axes = to_world[:3, :3] / np.cbrt(np.linalg.det(to_world[:3, :3]))

    def rotated(rotation: np.ndarray | None) -> np.ndarray | None:
        """Return a rotation of the light (3, 3) in the world's axes."""
        return None if rotation is None else axes @ rotation @ axes.T

    def placed(frames: list[Frame]) -> list[Frame]:
        return [
            replace(f, to_world=approximate_camera(f).moved(to_world).to_world, light_rotation=rotated(f.light_rotation)) for f in frames
        ]

    points = parsed.points
    if points is not None:
        position = points.position.astype(np.float64) @ to_world[:3, :3].T + to_world[:3, 3]
        points = PointCloud(position.astype(np.float32), points.colour)
    test = None if parsed.test is None else placed(parsed.test)
    whole = to_world @ parsed.to_world
    return replace(parsed, train=placed(parsed.train), test=test, novel=placed(parsed.novel), to_world=whole, points=points)


def approximate_camera(frame: Frame) -> Camera:
    """Return the frame's camera without its lens distortion, which is exact enough to find what it looks at."""
    lens = frame.lens
    return Camera(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, frame.to_world)
