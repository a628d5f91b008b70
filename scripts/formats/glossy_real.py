# SPDX-License-Identifier: GPL-3.0-or-later
"""NeRO's GlossyReal: photographs without masks, a COLMAP model, the object's points cut out, its directions in a text file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .colmap_files import write_model
from .source import Source, moved_points, over, placed, save_ply, save_png, similarity

BACKDROP = 0.45
WORLD = similarity((-120.0, 15.0, 40.0), 0.7, (0.4, -0.3, 2.5))  # structure from motion chooses an arbitrary frame


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/NAME.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the similarity (4, 4) from the scene's world to the dataset's frame.
    """
    scene = folder / source.name
    shots = {f"{1436 + i}.png": s for i, s in enumerate(source.interleaved())}
    for name, shot in shots.items():
        save_png(scene / "images" / name, over(shot.rgba, BACKDROP))
    width, height = source.size
    points = moved_points(WORLD, source.points)
    solved = np.concatenate([points, moved_points(WORLD, source.around)])
    parameters = [source.focal, width / 2, height / 2, 0.0]
    poses = {name: placed(WORLD, s.pose) for name, s in shots.items()}
    write_model(scene / "colmap" / "sparse" / "0", "SIMPLE_RADIAL", source.size, parameters, poses, solved)
    save_ply(scene / "object_point_cloud.ply", points)
    directions = np.stack([WORLD[:3, 2], WORLD[:3, 0]]) / np.cbrt(np.linalg.det(WORLD[:3, :3]))  # up and forward
    np.savetxt(scene / "meta_info.txt", directions)
    return scene, WORLD
