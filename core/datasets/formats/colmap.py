# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of COLMAP sparse models with their images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...io.safe_paths import inside
from ...scene.camera import GL_TO_CV, Camera
from ...scene.dataset import PointCloud
from ...settings.schema import DataSettings
from ..bound import find_look_at_point
from ..parsed_dataset import Frame, Lens, ParsedDataset, find_image, find_mask
from ..world_frame import approximate_camera, normalise_world_frame
from .colmap_model import CameraRecord, ImageRecord, PointRecords, model_files, read_cameras, read_images, read_points
from .ref_real import is_ref_real, with_published_sphere

MODEL_FOLDERS = ("", "sparse/0", "sparse", "0", "colmap/sparse/0", "colmap/sparse")
DOWNSCALES = (1, 2, 4, 8)
FAR = 100.0  # points farther away than this many camera distances are discarded


def find_model(folder: Path) -> Path | None:
    """Return the folder of the sparse model that `folder` is or contains, or None."""
    return next((folder / name for name in MODEL_FOLDERS if model_files(folder / name)), None)


def read_colmap(folder: Path, settings: DataSettings) -> ParsedDataset:
    """Read a sparse model; of `images`, `images_2`, ..., the smallest images that reach the resolution are used.

    The world is the model's frame, rotated so that the cameras' up is +Z and moved so that the object is at the origin; the scale is kept.

    Args:
        folder: the model's folder, or one that contains it.
        settings: settings of the dataset.

    Raises:
        InputError: if files are missing or damaged.
    """
    model = find_model(folder) or folder
    frames, points, root, warnings = read_frames(model, settings.resolution)
    parsed = normalise_world_frame(model, root, "colmap", frames, points, warnings)
    names = {split: _listed_names(root / f"{split}_id.txt") for split in ("train", "test")}
    if names["test"]:  # Stanford-ORB in its COLMAP form
        train, test = ([f for f in parsed.train if Path(f.listed).stem in names[split]] for split in ("train", "test"))
        return replace(parsed, format="stanford-orb", train=train, test=test)
    return with_published_sphere(parsed) if is_ref_real(root) else parsed


def read_frames(model: Path, resolution: int) -> tuple[list[Frame], PointCloud | None, Path, list[str]]:
    """Read the frames and points of a sparse model.

    Args:
        model: the model's folder.
        resolution: longest side in pixels that the images are used at.

    Returns:
        Frames and points in the model's own frame, the dataset's folder, and warnings.

    Raises:
        InputError: if files are missing or damaged.
    """
    files = model_files(model)
    if files is None:
        raise InputError(model, "has no files cameras and images, .bin or .txt")
    cameras, images, warnings = read_cameras(files["cameras"]), read_images(files["images"]), []
    if not images:
        raise InputError(files["images"], "lists no images")
    for image in images:
        if image.camera not in cameras:
            raise InputError(files["images"], f"image {image.name!r} uses camera {image.camera}, which is not in {files['cameras'].name}")
    lenses = {number: _lens(record).checked(f"{files['cameras']}, camera {number}") for number, record in cameras.items()}
    folder = _image_folder(model, images, max(max(lens.size) for lens in lenses.values()), resolution)
    frames = [_frame(image, lenses[image.camera], folder) for image in images]
    if "points3D" not in files:
        warnings.append(f"{model}: no points3D file; the object's bound is estimated without points")
        return frames, None, folder.parent, warnings
    records = read_points(files["points3D"])
    near = _near_points(model, [approximate_camera(f) for f in frames], records, warnings)
    points = PointCloud(records.position[near], records.colour[near].astype(np.float32) / 255)
    return frames, points, folder.parent, warnings


def _lens(record: CameraRecord) -> Lens:
    p = record.parameters
    two_focals = record.model in ("PINHOLE", "OPENCV", "OPENCV_FISHEYE")
    fx, fy, cx, cy, *k = p if two_focals else (p[0], *p)
    fisheye = record.model == "OPENCV_FISHEYE"
    # SIMPLE_RADIAL k1, RADIAL k1 k2, OPENCV k1 k2 p1 p2: all are the first coefficients of OpenCV's order.
    distortion = tuple(k) if fisheye or not k else (*k, 0.0, 0.0, 0.0, 0.0)[:5]
    return Lens(record.model, record.width, record.height, fx, fy, cx, cy, distortion, fisheye)


def _image_folder(model: Path, images: list[ImageRecord], longest: int, resolution: int) -> Path:
    """Find the folder that image names are relative to, next to the model or up to three levels above it."""
    roots = [parent for parent in (model, *model.absolute().parents[:3]) if any((parent / _scaled(n)).is_dir() for n in DOWNSCALES)]
    if not roots:
        fix = "put the images into a folder images, images_2, images_4 or images_8 next to or above it"
        raise InputError(model, "has no folder of images near it", fix)
    present = [n for n in DOWNSCALES if (roots[0] / _scaled(n)).is_dir()]
    filled = [n for n in present if any(find_image(inside(roots[0] / _scaled(n) / image.name, roots[0])) for image in images)]
    if not filled:
        raise InputError(roots[0] / _scaled(present[0]), f"has none of the images that the model names (such as {images[0].name})")
    sufficient = [n for n in filled if longest / n >= resolution]
    return roots[0] / _scaled(sufficient[-1] if sufficient else filled[0])


def _scaled(factor: int) -> str:
    return "images" if factor == 1 else f"images_{factor}"


def _frame(image: ImageRecord, lens: Lens, root: Path) -> Frame:
    photograph = find_image(inside(root / image.name, root.parent))
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = _rotation(image.quaternion), image.translation
    to_world = np.linalg.inv(world_to_camera) @ GL_TO_CV
    return Frame(image.name, photograph, find_mask(photograph, root) if photograph else None, lens, to_world)


def _rotation(quaternion: Sequence[float]) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z) of any length."""
    w, x, y, z = np.asarray(quaternion) / np.linalg.norm(quaternion)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])  # fmt: skip


def _near_points(model: Path, cameras: list[Camera], records: PointRecords, warnings: list[str]) -> np.ndarray:
    """Return (P,) bool, False for points that are farther away than FAR; raise InputError if those are most of the points."""
    target = find_look_at_point(cameras)
    extent = max(target.distance, *(float(np.linalg.norm(c.centre - target.point)) for c in cameras))
    near = (np.abs(records.position - target.point) < FAR * extent).all(-1)  # no squares: they would overflow
    far = int((~near).sum())
    if far * 2 > len(near):
        raise InputError(model, f"{far} of {len(near)} points are at infinity (over {FAR:g} times as far away as any camera)")
    if far:
        warnings.append(f"{model}: {far} of {len(near)} points are very far away and left out")
    return near


def _listed_names(file: Path) -> set[str]:
    """Read the stems of the image names in a text file, one a line; empty if there is no file."""
    try:
        return {Path(line.strip()).stem for line in file.read_text("utf-8").splitlines() if line.strip()} if file.is_file() else set()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(file, f"is not a list of images ({error})") from error
