# SPDX-License-Identifier: GPL-3.0-or-later
"""Ref-NeRF's real scenes: COLMAP with images at full, a quarter and an eighth of the size, the sphere of interest by the scene's name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from irgspp.core.datasets.formats.ref_real import SPHERES
from PIL import Image

from .colmap_files import write_model
from .source import Source, moved_points, over, placed, save_png, similarity

SCENE = "sedan"  # of which a scene takes the place that has no published name
BACKDROP = 0.6
REACH = 1.3  # radius of the scene's own object, which is scaled to the published sphere


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/NAME, one of the published names, which decide on the sphere of interest.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the similarity (4, 4) from the scene's world to the dataset's frame.
    """
    name = source.name if source.name in SPHERES else SCENE
    scene, (centre, radius) = folder / name, SPHERES[name]
    world = similarity((70.0, -20.0, 10.0), radius / REACH, centre)
    shots = {f"{i:05d}.png": s for i, s in enumerate(source.interleaved())}
    for name, shot in shots.items():
        pixels = over(shot.rgba, BACKDROP)
        for factor, place in ((1, "images"), (4, "images_4"), (8, "images_8")):
            save_png(scene / place / name, np.asarray(Image.fromarray(pixels).reduce(factor)))
    width, height = source.size
    poses = {name: placed(world, s.pose) for name, s in shots.items()}
    points = moved_points(world, np.concatenate([source.points, source.around]))
    write_model(scene / "sparse" / "0", "SIMPLE_RADIAL", source.size, [source.focal, width / 2, height / 2, 0.0], poses, points)
    return scene, world
