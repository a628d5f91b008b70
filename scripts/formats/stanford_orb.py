# SPDX-License-Identifier: GPL-3.0-or-later
"""Stanford-ORB: captures of one object under several lights, HDR and LDR, with masks; light maps in the frame of each view's camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from irgspp.core.io.srgb import encode_srgb

from .source import Shot, Source, placed, save_exr, save_json, save_png, similarity

WORLDS = [similarity((0, 0, 35.0 * i + 20), 0.8 + 0.1 * i, (0.1 * i, -0.2, 0.05)) for i in range(8)]  # each capture has its own frame
BACKDROP = 0.15  # linear grey behind the object


def write(source: Source, folder: Path, hdr: bool = True, trained: int | None = None) -> tuple[Path, np.ndarray]:
    """Write folder/blender_HDR (or _LDR) with a capture for each light, the training light's first, and folder/ground_truth.

    Args:
        source: scene to write.
        folder: folder of the collection.
        hdr: True for EXR photographs, False for PNG.
        trained: so many of the captures have training views; None: all.

    Returns:
        The first capture's folder, and the similarity (4, 4) from the scene's world to its frame.
    """
    root = folder / ("blender_HDR" if hdr else "blender_LDR")
    for number, light in enumerate(source.lights):
        train = source.train if number == 0 else source.test
        splits = {"train": train, "test": source.test} if trained is None or number < trained else {"test": source.test}
        _capture(source, splits, light, number, root, hdr)
    _novel(source, root / _name(source, 0))
    truth = folder / "ground_truth" / _name(source, 0)
    for i, shot in enumerate(source.test):
        _layers(shot, truth, f"{i:04d}")
    mesh = truth / "mesh_blender" / "mesh.obj"
    mesh.parent.mkdir(parents=True, exist_ok=True)
    surface = trimesh.convex.convex_hull(source.points) if source.surface is None else source.surface.copy()
    surface.apply_transform(WORLDS[0])
    surface.export(mesh)
    return root / _name(source, 0), WORLDS[0]


def _name(source: Source, number: int) -> str:
    """Return the name of a capture."""
    return f"{source.name}_scene{number + 1:03d}"


def _capture(source: Source, splits: dict[str, list[Shot]], light: str, number: int, root: Path, hdr: bool) -> None:
    """Write a capture with its own images, and the light maps of its test views."""
    scene = root / _name(source, number)
    for split, shots in splits.items():
        frames = []
        for i, shot in enumerate(shots):
            pose = placed(WORLDS[number], shot.pose)
            frames.append({"file_path": f"{split}/{i:04d}", "transform_matrix": pose.tolist()})
            _image(scene, split, f"{i:04d}", shot.radiance(light if light in shot.relit else ""), hdr)
            if split == "test":
                truth = root.parent / "ground_truth" / scene.name / "env_map"
                save_exr(truth / f"{i:04d}.exr", camera_map(source.lights[light], shot.pose[:3, :3]))
        save_json(scene / f"transforms_{split}.json", {"camera_angle_x": source.angle, "frames": frames})


def _image(scene: Path, split: str, name: str, radiance: np.ndarray, hdr: bool) -> None:
    """Write a photograph, of linear premultiplied radiance (H, W, 4), and its mask."""
    linear = radiance[..., :3] + BACKDROP * (1 - radiance[..., 3:])
    if hdr:
        save_exr(scene / split / f"{name}.exr", linear)
    else:
        save_png(scene / split / f"{name}.png", encode_srgb(np.clip(linear, 0, 1)))
    save_png(scene / f"{split}_mask" / f"{name}.png", (255 * (radiance[..., 3] > 0.5)).astype(np.uint8))


def _novel(source: Source, scene: Path) -> None:
    """Write the test views of the other captures, in the frame of this one; each frame has its own angle."""
    frames = []
    for number in range(1, len(source.lights)):
        for i, shot in enumerate(source.test):
            pose = placed(WORLDS[0], shot.pose).tolist()
            entry = {"file_path": f"test/{i:04d}", "scene_name": _name(source, number), "camera_angle_x": source.angle}
            frames.append({**entry, "transform_matrix": pose})
    save_json(scene / "transforms_novel.json", {"frames": frames})


def camera_map(light: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Resample a light map to the frame of a camera: -Z in the middle, +X to its right, +Y on top.

    Args:
        light: map of Blender's world (H, W, 3).
        rotation: camera to world (3, 3).

    Returns:
        (H, W, 3).
    """
    height, width = light.shape[:2]
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    turn, polar = 2 * np.pi * (u - 0.5), np.pi * v
    local = np.stack([np.sin(polar) * np.sin(turn), np.cos(polar), -np.sin(polar) * np.cos(turn)], -1)
    return sampled(light, local @ rotation.T)


def sampled(light: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Look up a light map of Blender's world bilinearly.

    Args:
        light: (H, W, 3).
        direction: unit directions (..., 3).

    Returns:
        (..., 3) float32.
    """
    height, width = light.shape[:2]
    column = (0.5 - np.arctan2(direction[..., 1], direction[..., 0]) / (2 * np.pi)) * width - 0.5
    row = np.clip(np.arccos(np.clip(direction[..., 2], -1, 1)) / np.pi * height - 0.5, 0, height - 1)
    left, top = np.floor(column).astype(int), np.minimum(np.floor(row).astype(int), height - 2)
    s, t = (column - left)[..., None], (row - top)[..., None]
    a, b = light[top, left % width], light[top, (left + 1) % width]
    c, d = light[top + 1, left % width], light[top + 1, (left + 1) % width]
    return ((1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d)).astype(np.float32)


def _layers(shot: Shot, truth: Path, name: str) -> None:
    """Write albedo, normals in the camera's frame, and depth in the capture's units, -1 where nothing is seen."""
    save_png(truth / "pseudo_gt_albedo" / f"{name}.png", encode_srgb(shot.layers["albedo"]))
    visible = shot.layers["depth"] > 0
    size = float(np.cbrt(np.linalg.det(WORLDS[0][:3, :3])))
    for kind, layer in (
        ("surface_normal", shot.layers["normal"] @ shot.pose[:3, :3]),
        ("z_depth", np.where(visible, shot.layers["depth"] * size, -1)),
    ):
        (truth / kind).mkdir(parents=True, exist_ok=True)
        np.save(truth / kind / f"{name}.npy", layer.astype(np.float32))
