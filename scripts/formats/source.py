# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene to write in other layouts: images, cameras, layers and lights as scripts/render_dataset.py writes them."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from irgspp.core.errors import InputError
from irgspp.core.io.exr import read_exr, read_exr_rgb, rgb_channels, write_exr
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from PIL import Image
from plyfile import PlyData, PlyElement
from scipy.spatial.transform import Rotation


@dataclass(frozen=True, eq=False)
class Shot:
    """View of a scene.

    Attributes:
        pose: (4, 4) camera to world, axes as Blender's.
        rgba: (H, W, 4) uint8, encoded, straight alpha.
        layers: of a test view: albedo (H, W, 3) linear, normal (H, W, 3) in the world, depth (H, W) planar, material (H, W, 2) where known.
        relit: (H, W, 4) uint8 by light.
        hdr: (H, W, 4) linear premultiplied by light, "" for the training light; empty where the scene was rendered without.
    """

    pose: np.ndarray
    rgba: np.ndarray
    layers: dict[str, np.ndarray] = field(default_factory=dict)
    relit: dict[str, np.ndarray] = field(default_factory=dict)
    hdr: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def alpha(self) -> np.ndarray:
        """Alpha (H, W), 0..1."""
        return self.rgba[..., 3] / 255

    @property
    def linear(self) -> np.ndarray:
        """Straight linear colour (H, W, 3), float32."""
        return decode_srgb(self.rgba[..., :3].astype(np.float32) / 255)

    def radiance(self, light: str = "") -> np.ndarray:
        """Return the linear premultiplied image (H, W, 4) under a light, "" for the training light; clipped where there is no HDR file."""
        if light in self.hdr:
            return self.hdr[light]
        rgba = self.relit.get(light, self.rgba).astype(np.float32) / 255
        return np.concatenate([decode_srgb(rgba[..., :3]) * rgba[..., 3:], rgba[..., 3:]], -1)


@dataclass(frozen=True, eq=False)
class Source:
    """Whole scene.

    Attributes:
        name: name of the scene.
        angle: horizontal field of view in radians.
        train: training views.
        test: test views with layers.
        lights: linear light maps (H, W, 3) by name, the training light first.
        points: surface samples (N, 3).
        normals: their normals (N, 3).
        around: points of the surroundings (P, 3).
        surface: the object's mesh; None where it is not known.
    """

    name: str
    angle: float
    train: list[Shot]
    test: list[Shot]
    lights: dict[str, np.ndarray]
    points: np.ndarray
    normals: np.ndarray
    around: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    surface: trimesh.Trimesh | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.train[0].rgba.shape[1], self.train[0].rgba.shape[0]

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.size[0] / math.tan(0.5 * self.angle)

    @property
    def relights(self) -> list[str]:
        """Names of the lights that test views were rendered under besides the training light."""
        return list(self.lights)[1:]

    def interleaved(self) -> list[Shot]:
        """Return all views, with a test view at every eighth place while there are any."""
        train, test, shots = list(self.train), list(self.test), []
        while train or test:
            shots.append(test.pop(0) if test and (len(shots) % 8 == 0 or not train) else train.pop(0))
        return shots


def load_source(folder: Path) -> Source:
    """Read a scene that scripts/render_dataset.py wrote.

    Args:
        folder: folder of the scene.

    Raises:
        InputError: where the folder is not such a scene.
    """
    if not (folder / "meta.json").is_file():
        raise InputError(folder, "is not a rendered scene", "scripts/render_dataset.py writes one")
    meta = json.loads((folder / "meta.json").read_text(encoding="utf-8"))
    names = [meta["train_light"], *meta["relights"]]
    content = {split: json.loads((folder / f"transforms_{split}.json").read_text(encoding="utf-8")) for split in ("train", "test")}
    shots = {split: [_shot(folder, f, names[1:]) for f in content[split]["frames"]] for split in content}
    lights = {name: read_exr_rgb(folder / "envs" / f"{name}.exr") for name in names}
    with np.load(folder / "surface_points.npz") as data:
        points, normals = data["points"].astype(np.float64), data["normals"].astype(np.float64)
        around = data["around"].astype(np.float64) if "around" in data else np.zeros((0, 3))
    mesh = folder / "surface.ply"
    surface = trimesh.load_mesh(mesh) if mesh.is_file() else None
    angle = content["train"]["camera_angle_x"]
    return Source(meta["name"], angle, shots["train"], shots["test"], lights, points, normals, around, surface)


def _shot(folder: Path, frame: dict[str, Any], relights: list[str]) -> Shot:
    """Read a view."""
    file = folder / (frame["file_path"] + ".png")
    pose = np.array(frame["transform_matrix"])
    hdr = {name: _read_hdr(f) for name, f in _hdr_files(file, relights).items() if f.is_file()}
    if not (file.parent / "depth.exr").is_file():
        return Shot(pose, read_rgba(file), hdr=hdr)
    layers = {"albedo": read_exr_rgb(file.parent / "albedo.exr"), "normal": read_exr_rgb(file.parent / "normal.exr")}
    layers["depth"] = read_exr(file.parent / "depth.exr")["Z"]
    if (file.parent / "material.exr").is_file():
        material = read_exr(file.parent / "material.exr")
        layers["material"] = np.stack([material["R"], material["G"]], -1)
    return Shot(pose, read_rgba(file), layers, {name: read_rgba(file.with_name(f"rgba_{name}.png")) for name in relights}, hdr)


def _hdr_files(file: Path, relights: list[str]) -> dict[str, Path]:
    """Return the HDR files that there may be of a view, by light."""
    return {"": file.with_suffix(".exr")} | {name: file.with_name(f"rgba_{name}.exr") for name in relights}


def _read_hdr(file: Path) -> np.ndarray:
    """Read an EXR image as (H, W, 4) float32."""
    channels = read_exr(file)
    return np.stack([channels[c] for c in "RGBA"], -1).astype(np.float32)


def read_rgba(file: Path) -> np.ndarray:
    """Read an image as (H, W, 4) uint8."""
    with Image.open(file) as image:
        return np.asarray(image.convert("RGBA"))


def save_png(file: Path, pixels: np.ndarray) -> None:
    """Write an 8-bit PNG file.

    Args:
        file: file to write; its folder is made.
        pixels: (H, W), (H, W, 3) or (H, W, 4), uint8 or floats in 0..1.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    pixels = pixels if pixels.dtype == np.uint8 else np.round(255 * np.clip(pixels, 0, 1)).astype(np.uint8)
    Image.fromarray(pixels).save(file)


def save_exr(file: Path, linear: np.ndarray) -> None:
    """Write an EXR file.

    Args:
        file: file to write; its folder is made.
        linear: (H, W, 3) linear.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    write_exr(file, rgb_channels(linear))


def save_hdr(file: Path, linear: np.ndarray) -> None:
    """Write a Radiance HDR file.

    Args:
        file: file to write; its folder is made.
        linear: (H, W, 3) linear.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), np.ascontiguousarray(linear[..., ::-1], np.float32))


def save_ply(file: Path, points: np.ndarray) -> None:
    """Write points as a PLY file.

    Args:
        file: file to write; its folder is made.
        points: (N, 3).
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    rows = np.array([tuple(p) for p in points], dtype=[(c, "f4") for c in "xyz"])
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(file))


def save_json(file: Path, content: object) -> None:
    """Write a JSON file.

    Args:
        file: file to write; its folder is made.
        content: objects that JSON can hold.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=1), encoding="utf-8")


def over(rgba: np.ndarray, backdrop: float | np.ndarray) -> np.ndarray:
    """Composite an image over a background, blended in linear light.

    Args:
        rgba: (H, W, 4) uint8, encoded.
        backdrop: encoded background, a number or (H, W, 3), 0..1.

    Returns:
        (H, W, 3) uint8, encoded.
    """
    alpha = rgba[..., 3:].astype(np.float32) / 255
    linear = decode_srgb(rgba[..., :3].astype(np.float32) / 255) * alpha
    behind = decode_srgb(np.broadcast_to(np.asarray(backdrop, np.float32), linear.shape))
    return np.round(255 * encode_srgb(linear + behind * (1 - alpha))).astype(np.uint8)


def placed(world: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Apply a similarity of the world to a pose and make it rigid again.

    Args:
        world: similarity (4, 4).
        pose: camera to world (4, 4).

    Returns:
        (4, 4).
    """
    moved = world @ pose
    moved[:3, :3] /= np.cbrt(np.linalg.det(moved[:3, :3]))
    return moved


def moved_points(world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Apply a similarity to points.

    Args:
        world: similarity (4, 4).
        points: (N, 3).

    Returns:
        (N, 3).
    """
    return points @ world[:3, :3].T + world[:3, 3]


def similarity(angles: tuple[float, float, float], scale: float, shift: tuple[float, float, float]) -> np.ndarray:
    """Return a similarity (4, 4).

    Args:
        angles: degrees about X, Y and Z, applied in that order.
        scale: scale factor.
        shift: translation.
    """
    world = np.eye(4)
    world[:3, :3] = scale * Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    world[:3, 3] = shift
    return world


def upright_camera(pose: np.ndarray) -> np.ndarray:
    """Return world to camera (4, 4) in OpenCV's axes for a pose (4, 4) in Blender's."""
    return np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(pose)
