# SPDX-License-Identifier: GPL-3.0-or-later
"""A run folder made from formulas, and Blender as a module with a settings folder of its own."""

import os
import tempfile

os.environ.setdefault("BLENDER_USER_RESOURCES", tempfile.mkdtemp(prefix="irgspp-blender-"))  # before bpy is imported

from pathlib import Path

import bpy  # noqa: F401 (first of all: it makes Blender's other modules importable)
import numpy as np
import pytest
from irgspp.core.colour import encode_srgb
from irgspp.core.datasets.camera import Camera, look_at
from irgspp.core.datasets.dataset import Bound, Dataset, View
from irgspp.core.scene.cameras import save_cameras
from irgspp.core.scene.exr import rgb_channels, write_exr
from irgspp.core.scene.mesh import Mesh
from irgspp.core.scene.ply import save_mesh_ply
from irgspp.core.scene.textures import save_textures
from irgspp.core.shading.lights import map_directions
from PIL import Image


def sphere(rows: int = 24, columns: int = 48) -> Mesh:
    """A unit sphere with a seam at u = 0: red grows with x, green with y; the lower half is metal; roughness grows with z."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    theta, phi = (1 - v) * np.pi, u * 2 * np.pi
    normal = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).round(7)
    a = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1)
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    faces = np.concatenate([np.stack([a, b, c], -1)[columns:], np.stack([a, c, d], -1)[:-columns]])
    normal[:, -1] = normal[:, 0]  # equal to the last bit on both sides of the seam
    flat = normal.reshape(-1, 3).astype(np.float32)
    albedo, roughness, metallic = materials(flat)
    return Mesh(
        flat, flat, np.stack([u, v], -1).reshape(-1, 2).astype(np.float32), faces.astype(np.int32), albedo, roughness, metallic, textures()
    )


def materials(point: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    albedo = 0.5 + 0.4 * np.stack([point[..., 0], point[..., 1], 0 * point[..., 2]], -1)
    return albedo.astype(np.float32), (0.5 + 0.3 * point[..., 2]).astype(np.float32), (point[..., 2] < 0).astype(np.float32)


def textures(size: int = 128) -> dict[str, np.ndarray]:
    v, u = np.meshgrid(1 - (np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    theta, phi = (1 - v) * np.pi, u * 2 * np.pi
    albedo, roughness, metallic = materials(np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1))
    flat = np.broadcast_to(np.array([128, 128, 255], np.uint8), (size, size, 3)).copy()
    return {"albedo": bytes8(encode_srgb(albedo)), "roughness": bytes8(roughness), "metallic": bytes8(metallic), "normal": flat}


def bytes8(values: np.ndarray) -> np.ndarray:
    return np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)


def axis_light(height: int = 64) -> np.ndarray:
    """Smooth, and different along all six half axes."""
    d = map_directions(height, 2 * height)
    return (0.5 + 0.5 * d * np.array([0.9, 0.7, 0.5]) + 0.2 * np.roll(d, 1, -1) ** 2).astype(np.float32)


def cameras() -> list[Camera]:
    """Square and stretched pixels, centred and off-centre principal points, wide and tall pictures."""
    lenses = [(64, 48, 70.0, 70.0, 32.0, 24.0), (48, 64, 60.0, 66.0, 20.5, 35.0), (50, 50, 80.0, 62.0, 30.0, 21.5)]
    placed = []
    for (width, height, fx, fy, cx, cy), eye in zip(lenses, [(4.0, 0.5, 1.0), (-2.0, 3.0, 0.7), (0.3, -4.0, -1.2)], strict=True):
        placed.append(Camera(width, height, fx, fy, cx, cy, look_at(eye, up=(0.1, 0.0, 1.0))))
    return placed


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run: mesh, textures, light and cameras with photographs."""
    folder = tmp_path_factory.mktemp("runs") / "sphere"
    photographs = tmp_path_factory.mktemp("photographs")
    folder.mkdir()
    mesh = sphere()
    save_mesh_ply(mesh, folder / "mesh.ply")
    save_textures(mesh.textures, folder / "textures")
    write_exr(folder / "environment.exr", rgb_channels(axis_light()))
    views = []
    for i, camera in enumerate(cameras()):
        picture = photographs / f"view{i}.png"
        Image.new("RGB", (camera.width, camera.height), (40 * i, 100, 200)).save(picture)
        views.append(View(f"view{i}", camera, picture, np.zeros((camera.height, camera.width, 3), np.float32), None))
    save_cameras(folder / "cameras.json", Dataset(photographs, "transforms", views[:2], views[2:], Bound((0, 0, 0), 1), np.eye(4)))
    return folder
