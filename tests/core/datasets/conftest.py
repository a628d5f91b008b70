# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiny dataset made from scratch: a coloured ball seen from a ring, written in every format by independent writers."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.scene.camera import look_at
from PIL import Image

W, H, FOCAL, RADIUS = 60, 48, 70.0, 0.5
MODEL_IDS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4, "OPENCV_FISHEYE": 5, "FOV": 7}


def ring(count: int, target: np.ndarray) -> list[np.ndarray]:
    """Poses around the target at two heights."""
    angles = 2 * np.pi * np.arange(count) / count
    return [look_at(target + 2.5 * np.array([np.cos(a), np.sin(a), 0.25 + 0.35 * (i % 2)]), target) for i, a in enumerate(angles)]


def photograph(pose: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Render a ball of this centre (H, W, 4) uint8, coloured by the direction of its normal."""
    x, y = np.meshgrid((np.arange(W) + 0.5 - W / 2) / FOCAL, (np.arange(H) + 0.5 - H / 2) / FOCAL)
    ray = np.stack([x, -y, -np.ones_like(x)], -1) @ pose[:3, :3].T
    origin = pose[:3, 3] - centre
    a, b, c = (ray**2).sum(-1), ray @ origin, origin @ origin - RADIUS**2
    under = b * b - a * c
    t = (-b - np.sqrt(np.maximum(under, 0))) / a
    colour = 0.5 + 0.4 * (origin + t[..., None] * ray) / RADIUS
    return np.concatenate([np.clip(colour, 0, 1) * 255, 255.0 * (under > 0)[..., None]], -1).round().astype(np.uint8)


@dataclass
class BallDataset:
    """Poses (camera to world) and images (H, W, 4) uint8 of the ball about `centre`, and the folder to write them to."""

    folder: Path
    centre: np.ndarray
    poses: list[np.ndarray]
    images: list[np.ndarray]
    size: tuple[int, int] = (W, H)
    focal: float = FOCAL
    radius: float = RADIUS

    @property
    def lens(self) -> dict:
        """Intrinsics as instant-ngp writes them."""
        return {"fl_x": FOCAL, "fl_y": FOCAL, "cx": W / 2, "cy": H / 2, "w": W, "h": H}

    @property
    def angle(self) -> dict:
        """Intrinsics as NeRF-synthetic writes them."""
        return {"camera_angle_x": 2 * np.arctan(W / 2 / FOCAL)}

    def save_images(self, names: list[str], alpha: bool = True) -> None:
        for name, image in zip(names, self.images, strict=True):
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image if alpha else image[..., :3]).save(path, quality=95)

    def transforms(self, name: str = "transforms.json", names: list[str] | None = None, alpha: bool = True, **values: object) -> Path:
        """Write the images and a transforms file; `values` replaces the shared intrinsics."""
        listed = names or [f"images/{i:03d}.png" for i in range(len(self.poses))]
        self.save_images([n if "." in Path(n).name else n + ".png" for n in listed], alpha)
        frames = [{"file_path": n, "transform_matrix": p.tolist()} for n, p in zip(listed, self.poses, strict=True)]
        path = self.folder / name
        path.write_text(json.dumps({**(values or self.lens), "frames": frames}))
        return path

    def edit(self, path: Path, change) -> None:
        """Change the content of a JSON file."""
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    def colmap(
        self,
        binary: bool,
        model: str = "PINHOLE",
        parameters: tuple[float, ...] | None = None,
        images: str = "images",
        names: list[str] | None = None,
        alpha: bool = False,
        points: np.ndarray | None = None,
    ) -> Path:
        """Write the images and a sparse model in the same world; return the model's folder."""
        listed = names or [f"{i:03d}.png" for i in range(len(self.poses))]
        self.save_images([f"{images}/{n}" for n in listed], alpha)
        parameters = parameters or (FOCAL, FOCAL, W / 2, H / 2)
        points = self.surface() if points is None else points
        folder = self.folder / "sparse" / "0"
        folder.mkdir(parents=True)
        poses = [(quaternion(m[:3, :3]), m[:3, 3]) for m in (np.diag([1, -1, -1, 1]) @ np.linalg.inv(p) for p in self.poses)]
        (write_binary if binary else write_text)(folder, model, parameters, listed, poses, points, self.colour_of(points))
        return folder

    def surface(self, count: int = 300) -> np.ndarray:
        """(N, 3) points on the ball."""
        direction = np.random.default_rng(1).normal(size=(count, 3))
        return self.centre + RADIUS * direction / np.linalg.norm(direction, axis=-1, keepdims=True)

    def colour_of(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) uint8."""
        return np.clip((0.5 + 0.4 * (points - self.centre) / RADIUS) * 255, 0, 255).round().astype(np.uint8)


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z) as the eigenvector of the largest eigenvalue of Bar-Itzhack's matrix."""
    r = rotation
    k = (
        np.array(
            [
                [r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
                [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
                [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
                [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
            ]
        )
        / 3
    )
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return np.array([w, x, y, z])


def write_text(folder, model, parameters, names, poses, points, colours) -> None:
    numbers = " ".join(repr(float(p)) for p in parameters)
    (folder / "cameras.txt").write_text(f"# cameras\n1 {model} {W} {H} {numbers}\n")
    lines = ["# images"]
    for i, (name, (q, t)) in enumerate(zip(names, poses, strict=True)):
        lines += [f"{i + 1} {' '.join(repr(float(v)) for v in (*q, *t))} 1 {name}", "1.5 2.5 1 3.5 4.5 -1" if i % 2 else ""]
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    pairs = enumerate(zip(points.tolist(), colours, strict=True))
    rows = [f"{i} {x!r} {y!r} {z!r} {r} {g} {b} 0.5 1 0 2 1" for i, ((x, y, z), (r, g, b)) in pairs]
    (folder / "points3D.txt").write_text("# points\n" + "\n".join(rows) + "\n")


def write_binary(folder, model, parameters, names, poses, points, colours) -> None:
    camera = struct.pack("<QIiQQ", 1, 1, MODEL_IDS[model], W, H) + struct.pack(f"<{len(parameters)}d", *parameters)
    (folder / "cameras.bin").write_bytes(camera)
    images = struct.pack("<Q", len(names))
    for i, (name, (q, t)) in enumerate(zip(names, poses, strict=True)):
        images += struct.pack("<I7dI", i + 1, *q, *t, 1) + name.encode() + b"\0"
        images += struct.pack("<Q", 2) + struct.pack("<ddQddQ", 1.5, 2.5, 1, 3.5, 4.5, 2**64 - 1)
    (folder / "images.bin").write_bytes(images)
    data = struct.pack("<Q", len(points))
    for i, (position, colour) in enumerate(zip(points, colours, strict=True)):
        data += struct.pack("<Q3d3BdQ", i, *position, *colour, 0.5, 2) + struct.pack("<4I", 1, 0, 2, 1)
    (folder / "points3D.bin").write_bytes(data)


@pytest.fixture
def ball_dataset(tmp_path: Path) -> BallDataset:
    """Ten views around a ball that is not at the origin."""
    centre = np.array([0.3, -0.2, 0.4])
    poses = ring(10, centre)
    return BallDataset(tmp_path, centre, poses, [photograph(p, centre) for p in poses])


@pytest.fixture
def confined_dataset(ball_dataset: BallDataset, tmp_path_factory: pytest.TempPathFactory) -> BallDataset:
    """The dataset in a folder of its own, next to an image outside of it that must not be read."""
    home = tmp_path_factory.mktemp("home")
    ball_dataset.folder = home / "dataset"
    ball_dataset.folder.mkdir()
    Image.fromarray(ball_dataset.images[0]).save(home / "secret.png")
    return ball_dataset
