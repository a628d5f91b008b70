# SPDX-License-Identifier: GPL-3.0-or-later
"""Small datasets with unusual lenses, and the cameras that the engine's readers find in them: `python posed_photographs.py KIND FOLDER`.

FOLDER/dataset is the dataset; FOLDER/truth.json holds the readers' cameras for images of full size, and the points.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import irgspp.core
import numpy as np
from irgspp.core.scene.camera import look_at

W, H = 90, 62
CENTRE = np.array([0.4, -0.3, 0.2])
LENSES = {"stretched": (95.0, 71.0, 39.25, 36.5), "distorted": (88.0, 84.0, 47.0, 29.0)}  # fx, fy, cx, cy
DISTORTION = (-0.12, 0.03, 0.002, -0.001)


def poses() -> list[np.ndarray]:
    """Return twelve camera-to-world matrices (4, 4), some of which look almost straight down or up."""
    angle, height = np.arange(12) * 2.4, np.linspace(-0.98, 0.999, 12)
    r = np.sqrt(1 - height**2)
    return [look_at(CENTRE + 3 * np.array([s * np.cos(a), s * np.sin(a), z]), CENTRE) for s, a, z in zip(r, angle, height, strict=True)]


def points() -> tuple[np.ndarray, np.ndarray]:
    """Return positions (200, 3) around the centre and colours (200, 3) uint8."""
    random = np.random.default_rng(3)
    return CENTRE + random.normal(scale=0.2, size=(200, 3)), random.integers(0, 256, (200, 3)).astype(np.uint8)


def write_images(folder: Path) -> list[str]:
    from PIL import Image

    folder.mkdir(parents=True)
    y, x = np.mgrid[:H, :W]
    for i in range(12):
        image = np.stack([255 * x / W, 255 * y / H, np.full((H, W), 20.0 * i)], -1)
        Image.fromarray(image.astype(np.uint8)).save(folder / f"{i:03d}.png")
    return [f"{i:03d}.png" for i in range(12)]


def write_transforms(folder: Path) -> None:
    """Write transforms.json without a split, with unequal focal lengths and a principal point off the centre."""
    names = write_images(folder / "images")
    fx, fy, cx, cy = LENSES["stretched"]
    frames = [{"file_path": f"images/{n}", "transform_matrix": p.tolist()} for n, p in zip(names, poses(), strict=True)]
    lens = {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": W, "h": H}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))


def write_colmap(folder: Path) -> None:
    """Write a COLMAP model as text with a distorted lens and points; its up axis is -Y, as is common with COLMAP."""
    turned = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    write_model(folder, "OPENCV", (*LENSES["distorted"], *DISTORTION), turned)


def write_model(folder: Path, lens: str, parameters: tuple[float, ...], turned: np.ndarray) -> None:
    """Write images and a COLMAP model as text.

    Args:
        folder: of the dataset.
        lens: COLMAP's name of the lens model.
        parameters: of the lens.
        turned: (4, 4) from the frame of `poses` and `points` to the model's.
    """
    names, model = write_images(folder / "images"), folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text(f"1 {lens} {W} {H} {' '.join(map(repr, parameters))}\n")
    lines = []
    for i, (name, pose) in enumerate(zip(names, poses(), strict=True)):
        to_camera = np.diag([1, -1, -1, 1]) @ np.linalg.inv(turned @ pose)
        numbers = " ".join(repr(float(v)) for v in (*quaternion(to_camera[:3, :3]), *to_camera[:3, 3]))
        lines += [f"{i + 1} {numbers} 1 {name}", ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    places, colours = points()
    pairs = enumerate(zip((places @ turned[:3, :3].T).tolist(), colours, strict=True))
    rows = [f"{i} {' '.join(map(repr, p))} {' '.join(map(str, c))} 0.5 1 0 2 1" for i, (p, c) in pairs]
    (model / "points3D.txt").write_text("\n".join(rows) + "\n")


def quaternion(r: np.ndarray) -> np.ndarray:
    """Return the quaternion (w, x, y, z) of a rotation (3, 3): the eigenvector of the largest eigenvalue of a quadratic form."""
    k = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
        [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
        [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
    ])  # fmt: skip
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return np.array([w, x, y, z])


def write_truth(dataset: Path, path: Path) -> None:
    """Write the result of the engine's readers: cameras {"split name": [width, height, fx, fy, cx, cy, to_world]}, points and frame."""
    from irgspp.core.datasets.load import load_dataset
    from irgspp.core.settings.schema import DataSettings

    data = load_dataset(dataset, DataSettings(resolution=1000))
    views = [(f"{split} {view.name}", view.camera) for split in ("train", "test") for view in getattr(data, split)]
    cameras = {name: [c.width, c.height, c.fx, c.fy, c.cx, c.cy, c.to_world.tolist()] for name, c in views}
    cloud = None if data.points is None else [data.points.position.tolist(), data.points.colour.tolist()]
    truth = {"cameras": cameras, "points": cloud, "to_world": data.to_world.tolist(), "centre": list(data.bound.centre)}
    path.write_text(json.dumps(truth))


if __name__ == "__main__":
    kind, folder = sys.argv[1], Path(sys.argv[2])
    if kind == "demo":
        write_truth(Path(irgspp.core.__file__).parent / "demo_data", folder / "truth.json")
    else:
        {"stretched": write_transforms, "distorted": write_colmap}[kind](folder / "dataset")
        write_truth(folder / "dataset", folder / "truth.json")
