# SPDX-License-Identifier: GPL-3.0-or-later
"""NeRF-synthetic, with Shiny Blender's normals."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .source import Source, save_json, save_png


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/NAME.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the identity (4, 4): the dataset has the scene's frame.
    """
    scene = folder / source.name
    for split, shots in (("train", source.train), ("val", source.test[:1]), ("test", source.test)):
        frames = []
        for i, shot in enumerate(shots):
            frames.append({"file_path": f"./{split}/r_{i}", "rotation": 0.0126, "transform_matrix": shot.pose.tolist()})
            save_png(scene / split / f"r_{i}.png", shot.rgba)
            if split == "test":
                save_png(scene / split / f"r_{i}_depth_0001.png", shot.layers["depth"] / 8)  # of no known scale, as in the originals
                normal = np.concatenate([0.5 + 0.5 * shot.layers["normal"], shot.alpha[..., None]], -1)
                save_png(scene / split / f"r_{i}_normal.png", normal)
        save_json(scene / f"transforms_{split}.json", {"camera_angle_x": source.angle, "frames": frames})
    return scene, np.eye(4)
