# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture as instant-ngp's colmap2nerf writes it: shared intrinsics, sharpness, all images in one list."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from .lens import RealLens
from .source import Source, placed, save_json, save_png, similarity

WORLD = similarity((0.0, 0.0, 110.0), 1.5, (0.3, 0.0, 0.2))


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/NAME with images that have an alpha channel, as instant-ngp takes them.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the similarity (4, 4) from the scene's world to the dataset's frame.
    """
    scene, lens = folder / source.name, RealLens.of(source)
    frames = []
    for number, shot in enumerate(source.interleaved()):
        name = f"./images/{number:04d}.png"
        save_png(scene / name, lens.image(source, shot.rgba))
        frames.append({"file_path": name, "sharpness": 30.0 + number, "transform_matrix": placed(WORLD, shot.pose).tolist()})
    k1, k2, p1, p2, _ = lens.distortion
    width, height = source.size
    angles = {f"camera_angle_{axis}": 2 * math.atan(side / 2 / lens.focal) for axis, side in zip("xy", source.size, strict=True)}
    content = {**angles, "fl_x": lens.focal, "fl_y": lens.focal, "k1": k1, "k2": k2, "k3": 0, "k4": 0, "p1": p1, "p2": p2}
    content |= {"is_fisheye": False, "cx": lens.cx, "cy": lens.cy, "w": float(width), "h": float(height), "aabb_scale": 4}
    save_json(scene / "transforms.json", {**content, "frames": frames})
    return scene, WORLD
