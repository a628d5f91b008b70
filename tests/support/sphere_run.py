# SPDX-License-Identifier: GPL-3.0-or-later
"""Run folder of an analytic sphere; numpy suffices to import this, the engine's Python writes it: `python sphere_run.py FOLDER ...`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from irgspp.core.scene.camera import Camera, look_at
from irgspp.core.scene.mesh import Mesh


def sphere(rows: int = 24, columns: int = 48, size: int = 128) -> Mesh:
    """Return a unit sphere with a seam at u = 0: red grows with x, green with y, roughness with z; the lower half is metal."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    theta, phi = (1 - v) * np.pi, u * 2 * np.pi
    normal = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).round(7)
    a = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1)
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    faces = np.concatenate([np.stack([a, b, c], -1)[columns:], np.stack([a, c, d], -1)[:-columns]])
    normal[:, -1] = normal[:, 0]  # equal to the last bit on both sides of the seam
    flat = normal.reshape(-1, 3).astype(np.float32)
    uvs = np.stack([u, v], -1).reshape(-1, 2).astype(np.float32)
    return Mesh(flat, flat, uvs, faces.astype(np.int32), *materials(flat), textures(size))


def materials(point: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return albedo (..., 3), roughness (...) and metallic (...) at points (..., 3) of the sphere."""
    albedo = 0.5 + 0.4 * np.stack([point[..., 0], point[..., 1], 0 * point[..., 2]], -1)
    return albedo.astype(np.float32), (0.5 + 0.3 * point[..., 2]).astype(np.float32), (point[..., 2] < 0).astype(np.float32)


def textures(size: int = 128) -> dict[str, np.ndarray]:
    """Return textures as in `Mesh.textures`: (size, size[, 3]) uint8."""
    v, u = np.meshgrid(1 - (np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij")
    theta, phi = (1 - v) * np.pi, u * 2 * np.pi
    albedo, roughness, metallic = materials(np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1))
    flat = np.broadcast_to(np.array([128, 128, 255], np.uint8), (size, size, 3)).copy()
    return {"albedo": _bytes(_encoded(albedo)), "roughness": _bytes(roughness), "metallic": _bytes(metallic), "normal": flat}


def _encoded(albedo: np.ndarray) -> np.ndarray:
    return np.where(albedo <= 0.0031308, 12.92 * albedo, 1.055 * albedo ** (1 / 2.4) - 0.055)


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)


def map_directions(height: int, width: int) -> np.ndarray:
    """Return the unit directions (H, W, 3) float64 of a lat-long map's texel centres: row 0 at +Z, +X in the middle."""
    phi = (0.5 - (np.arange(width) + 0.5) / width) * 2 * np.pi
    theta = (np.arange(height)[:, None] + 0.5) / height * np.pi
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], -1)


def axis_light(height: int = 64) -> np.ndarray:
    """Return a smooth environment map (H, 2H, 3) with different colours along all six half axes."""
    d = map_directions(height, 2 * height)
    return (0.5 + 0.5 * d * np.array([0.9, 0.7, 0.5]) + 0.2 * np.roll(d, 1, -1) ** 2).astype(np.float32)


def cameras() -> list[Camera]:
    """Return cameras with square and stretched pixels, centred and off-centre principal points, wide and tall images."""
    lenses = [(64, 48, 70.0, 70.0, 32.0, 24.0), (48, 64, 60.0, 66.0, 20.5, 35.0), (50, 50, 80.0, 62.0, 30.0, 21.5)]
    placed = []
    for (width, height, fx, fy, cx, cy), eye in zip(lenses, [(4.0, 0.5, 1.0), (-2.0, 3.0, 0.7), (0.3, -4.0, -1.2)], strict=True):
        placed.append(Camera(width, height, fx, fy, cx, cy, look_at(eye, up=(0.1, 0.0, 1.0))))
    return placed


def in_tiles(size: int, tiles: int) -> Mesh:
    """Return the sphere with its charts and textures (size, size) in tiles x tiles UDIM tiles."""
    from dataclasses import replace

    from irgspp.core.surface.mesh_texels import mesh_texels
    from irgspp.core.surface.unwrap import unwrapped_again

    mesh = unwrapped_again(sphere(size=size), size, tiles)
    texels = mesh_texels(mesh.vertices, mesh.uvs, mesh.faces, size)
    place = texels.interpolated(mesh.vertices, mesh.faces)
    albedo, roughness, metallic = materials(place / np.linalg.norm(place, axis=-1, keepdims=True))
    images = {"albedo": _bytes(_encoded(albedo)), "roughness": _bytes(roughness), "metallic": _bytes(metallic)}
    return replace(mesh, textures={name: texels.image(values) for name, values in images.items()} | {"normal": textures(size)["normal"]})


def write_run(folder: Path, size: int = 128, confidence: int = 0, tiles: int = 1) -> None:
    """Write mesh, textures, light and cameras of a finished run by the engine's own functions, and its photographs next to it.

    Args:
        folder: of the run.
        size: texels along a side of the textures.
        confidence: 1 for a mesh with a confidence z that grows from 0 to 1, and z, 1 - z and z^2 for its materials.
        tiles: UDIM tiles along a side.
    """
    import json
    from dataclasses import replace

    from irgspp.core.assets.mesh_files import save_tiles
    from irgspp.core.io.exr import rgb_channels, write_exr
    from irgspp.core.scene.camera_files import save_cameras
    from irgspp.core.scene.dataset import Bound, Dataset, View
    from irgspp.core.scene.mesh_ply import save_mesh_ply
    from irgspp.core.scene.textures import save_textures
    from PIL import Image

    photographs = folder.parent / "photographs"
    for needed in (folder, photographs):
        needed.mkdir(parents=True, exist_ok=True)
    mesh, views = sphere(size=size) if tiles == 1 else in_tiles(size, tiles), []
    height = 0.5 + 0.5 * mesh.vertices[:, 2]
    known = {"confidence": height, "material_confidence": np.stack([height, 1 - height, height**2], -1)} if confidence else {}
    save_mesh_ply(replace(mesh, **known), folder / "mesh.ply")
    save_textures(mesh.textures, folder / "textures")
    save_tiles(mesh.textures, folder / "textures", tiles)
    if tiles > 1:
        (folder / "run.json").write_text(json.dumps({"settings": {}, "phases": {}, "textures": {"tiles": tiles}}))
    write_exr(folder / "environment.exr", rgb_channels(axis_light()))
    for i, camera in enumerate(cameras()):
        image = photographs / f"view{i}.png"
        Image.new("RGB", (camera.width, camera.height), (40 * i, 100, 200)).save(image)
        views.append(View(f"view{i}", camera, image, np.zeros((camera.height, camera.width, 3), np.float32), None))
    frame = {"bound": {"centre": [0, 0, 0], "radius": 1}, "to_world": np.eye(4).tolist()}
    (folder / "reconstruction.json").write_text(json.dumps(frame))
    save_cameras(folder / "cameras.json", Dataset(photographs, "transforms", views[:2], views[2:], Bound((0, 0, 0), 1), np.eye(4)))


if __name__ == "__main__":
    write_run(Path(sys.argv[1]), *map(int, sys.argv[2:]))
