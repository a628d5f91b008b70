# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a rendered dataset: photographs, material layers and the true surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from irgspp.core.io.exr import rgb_channels, write_exr
from irgspp.core.io.srgb import encode_srgb
from PIL import Image

Points = tuple[np.ndarray, np.ndarray]  # positions (N, 3), normals (N, 3)


def save_png(path: Path, rgba: np.ndarray) -> None:
    """Write a linear premultiplied image as an 8-bit sRGB PNG file with straight alpha.

    Args:
        path: file to write.
        rgba: (H, W, 4) linear premultiplied.
    """
    alpha = np.clip(rgba[..., 3:], 0, 1)
    straight = np.where(alpha > 0, rgba[..., :3] / np.maximum(alpha, 1e-6), 0)
    encoded = np.concatenate([encode_srgb(np.clip(straight, 0, 1)), alpha], -1)
    Image.fromarray(np.round(255 * encoded).astype(np.uint8), "RGBA").save(path, optimize=True)


def save_photograph(path: Path, rgba: np.ndarray, hdr: bool) -> None:
    """Write an image as a PNG file, and with `hdr` as an EXR file next to it, linear and premultiplied.

    Args:
        path: PNG file to write.
        rgba: (H, W, 4) linear premultiplied.
        hdr: write the EXR file, too.
    """
    save_png(path, rgba)
    if hdr:
        write_exr(path.with_suffix(".exr"), {name: rgba[..., i] for i, name in enumerate("RGBA")}, half=True)


def write_layers(view: Path, layers: dict[str, np.ndarray]) -> None:
    """Write the ground truth of a view as EXR files.

    Args:
        view: folder of the view.
        layers: albedo (H, W, 3), normal (H, W, 3), depth (H, W), material (H, W, 2).
    """
    write_exr(view / "albedo.exr", rgb_channels(layers["albedo"]), half=True)
    write_exr(view / "normal.exr", rgb_channels(layers["normal"]), half=True)
    write_exr(view / "depth.exr", {"Z": np.round(layers["depth"] * 16384) / 16384})
    write_exr(view / "material.exr", {"R": layers["material"][..., 0], "G": layers["material"][..., 1]}, half=True)


def write_surface(folder: Path, visible: Points, triangles: np.ndarray, around: Points) -> None:
    """Write surface_points.npz and surface.ply: samples of the object, those of the table, and the object's triangles.

    Args:
        folder: folder of the dataset.
        visible: samples that some camera sees, and their normals.
        triangles: corners of the object's triangles (T, 3, 3).
        around: points on the table and their normals, none without one.
    """
    points, normals = visible
    arrays = {"points": points.astype(np.float32), "normals": normals.astype(np.float16)}
    if len(around[0]):
        arrays |= {"around": around[0].astype(np.float32)}
    np.savez_compressed(folder / "surface_points.npz", **arrays)
    mesh = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=True)
    mesh.export(folder / "surface.ply")
