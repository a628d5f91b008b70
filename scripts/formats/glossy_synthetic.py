# SPDX-License-Identifier: GPL-3.0-or-later
"""NeRO's GlossySynthetic: pickled cameras, 16-bit depth, a world with +Y up, relit images in folders of their own."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np

from .source import Shot, Source, moved_points, over, placed, save_exr, save_ply, save_png, upright_camera

RELIGHTS = ("corridor", "golf", "neon")
DEPTH_RANGE = 15.0
WORLD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # Blender's (x, y, z) to (x, z, -y)


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/GlossySynthetic/NAME, folder/relight_gt and folder/hdr2k; every eighth view is a test view while there are any.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the similarity (4, 4) from the scene's world to the dataset's frame.
    """
    scene = folder / "GlossySynthetic" / source.name
    for number, shot in enumerate(source.interleaved()):
        _view(source, shot, shot.rgba, scene, number)
    save_ply(scene / "eval_pts.ply", moved_points(WORLD, source.points))
    for light, name in zip(source.relights, RELIGHTS, strict=False):
        save_exr(folder / "hdr2k" / f"{name}.exr", source.lights[light])
        for number, shot in enumerate(source.test):
            _view(source, shot, shot.relit[light], folder / "relight_gt" / f"{source.name}_{name}", number)
    return scene, WORLD


def _view(source: Source, shot: Shot, rgba: np.ndarray, folder: Path, number: int) -> None:
    """Write a view: colour over white with soft edges, and depth with a hard edge."""
    save_png(folder / f"{number}.png", over(rgba, 1.0))
    width, height = source.size
    intrinsics = np.array([[source.focal, 0, width / 2], [0, source.focal, height / 2], [0, 0, 1]])
    camera = (upright_camera(placed(WORLD, shot.pose))[:3], intrinsics)
    (folder / f"{number}-camera.pkl").write_bytes(pickle.dumps(camera))
    near = shot.layers.get("depth", np.full(shot.alpha.shape, float(np.linalg.norm(shot.pose[:3, 3]))))
    depth = np.where((shot.alpha > 0.5) & (near > 0), near, DEPTH_RANGE)
    cv2.imwrite(str(folder / f"{number}-depth.png"), np.round(depth / DEPTH_RANGE * 65535).astype(np.uint16))
