# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture processed by nerfstudio: one transforms.json with a camera model, points, masks, splits, and smaller copies of the images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from .lens import RealLens
from .source import Source, moved_points, over, placed, save_json, save_ply, save_png, similarity

BACKDROP = 0.5
WORLD = similarity((0.0, 0.0, -50.0), 0.25, (0.05, 0.1, -0.1))


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/NAME.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the similarity (4, 4) from the scene's world to the dataset's frame.
    """
    scene, lens = folder / source.name, RealLens.of(source)
    frames, tests = [], {id(s) for s in source.test}
    listed: dict[str, list[str]] = {"train": [], "test": []}
    for number, shot in enumerate(source.interleaved(), 1):
        name = f"frame_{number:05d}.png"
        rgba = lens.image(source, shot.rgba)
        save_png(scene / "images" / name, over(rgba, BACKDROP))
        save_png(scene / "images_2" / name, np.asarray(Image.fromarray(over(rgba, BACKDROP)).reduce(2)))
        save_png(scene / "masks" / name, rgba[..., 3])
        pose = placed(WORLD, shot.pose).tolist()
        frames.append({"file_path": f"images/{name}", "mask_path": f"masks/{name}", "transform_matrix": pose, "colmap_im_id": number})
        listed["test" if id(shot) in tests else "train"].append(f"images/{name}")
    k1, k2, p1, p2, _ = lens.distortion
    width, height = source.size
    content = {"w": width, "h": height, "fl_x": lens.focal, "fl_y": lens.focal, "cx": lens.cx, "cy": lens.cy, "camera_model": "OPENCV"}
    content |= {"k1": k1, "k2": k2, "p1": p1, "p2": p2, "applied_transform": np.eye(4)[:3].tolist(), "ply_file_path": "sparse_pc.ply"}
    content |= {f"{split}_filenames": names for split, names in listed.items()}
    save_json(scene / "transforms.json", {**content, "val_filenames": listed["test"], "frames": frames})
    save_ply(scene / "sparse_pc.ply", moved_points(WORLD, source.points))
    return scene, WORLD
