# SPDX-License-Identifier: GPL-3.0-or-later
"""Binary files of a COLMAP sparse model."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .source import upright_camera

MODELS = {"PINHOLE": 1, "SIMPLE_RADIAL": 2}


def write_model(
    folder: Path, model: str, size: tuple[int, int], parameters: list[float], poses: dict[str, np.ndarray], points: np.ndarray
) -> None:
    """Write cameras.bin, images.bin and points3D.bin with one camera.

    Args:
        folder: folder to make.
        model: COLMAP's camera model, one of MODELS.
        size: width and height in pixels.
        parameters: parameters of the camera model.
        poses: (4, 4) camera to world, axes as Blender's, by image name.
        points: sparse points (N, 3).
    """
    folder.mkdir(parents=True, exist_ok=True)
    camera = struct.pack("<QIiQQ", 1, 1, MODELS[model], *size) + struct.pack(f"<{len(parameters)}d", *parameters)
    (folder / "cameras.bin").write_bytes(camera)
    images = struct.pack("<Q", len(poses))
    for number, (name, pose) in enumerate(poses.items(), 1):
        matrix = upright_camera(pose)
        x, y, z, w = Rotation.from_matrix(matrix[:3, :3]).as_quat()
        images += struct.pack("<I7dI", number, w, x, y, z, *matrix[:3, 3], 1) + name.encode() + b"\0" + struct.pack("<Q", 0)
    (folder / "images.bin").write_bytes(images)
    rows = b"".join(struct.pack("<Q3d3BdQ", i, *p, 128, 128, 128, 0.5, 2) + struct.pack("<4I", 1, 0, 2, 0) for i, p in enumerate(points))
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", len(points)) + rows)
