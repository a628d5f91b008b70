# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras as RealityCapture exports them: CSV with a survey's angles, +Z up, coordinates far from the origin."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .lens import RealLens
from .source import Source, over, placed, save_png, similarity

BACKDROP = 0.5
WORLD = similarity((0.0, 0.0, 65.0), 1.2, (250.0, -120.0, 35.0))
COLUMNS = ["#name", "x", "y", "alt", "heading", "pitch", "roll", "f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2"]


def write(source: Source, folder: Path, world: np.ndarray = WORLD) -> tuple[Path, np.ndarray]:
    """Write folder/NAME with cameras.csv, images and masks.

    Args:
        source: scene to write.
        folder: folder of the collection.
        world: similarity (4, 4) from the scene's world to the dataset's frame; it may be tilted, as without a defined ground.

    Returns:
        The scene's folder, and the similarity.
    """
    scene, lens = folder / source.name, RealLens.of(source)
    (width, height), longest = source.size, max(source.size)
    k1, k2, p1, p2, k3 = lens.distortion
    intrinsics = [lens.focal * 36 / longest, (lens.cx - width / 2) / longest, (lens.cy - height / 2) / longest, k1, k2, k3, 0, p1, p2]
    rows = []
    for number, shot in enumerate(source.interleaved()):
        name = f"DSC{number:05d}.png"
        rgba = lens.image(source, shot.rgba)
        save_png(scene / "images" / name, over(rgba, BACKDROP))
        save_png(scene / "masks" / name, rgba[..., 3])
        pose = placed(world, shot.pose)
        yaw, pitch, roll = Rotation.from_matrix(pose[:3, :3]).as_euler("ZXY", degrees=True)
        rows.append([name, *(repr(float(v)) for v in (*pose[:3, 3], -yaw, pitch, roll, *intrinsics))])
    with (scene / "cameras.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    return scene, world
