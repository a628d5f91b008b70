# SPDX-License-Identifier: GPL-3.0-or-later
"""The transforms.json family: NeRF-synthetic, instant-ngp, nerfstudio."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from plyfile import PlyData

from ..errors import InputError
from .capture import FARTHEST, Capture, Frame, Lens, find_mask, find_picture
from .dataset import PointCloud
from .picture import picture_size

RADIAL_MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
FISHEYE_MODEL = "OPENCV_FISHEYE"
RIGID_TOLERANCE = 1e-3
LARGEST_SIDE = 1 << 20

Size = tuple[int, int]


def read_transforms(train: Path, test: Path | None = None) -> Capture:
    """Read a transforms file, with the one of the test views where the dataset has its own.

    The world is taken as it is (+Z up by convention). Raises InputError on anything missing, not finite or not rigid.
    """
    content = _load(train)
    pictures = _pictures(train, content)
    size = _known_size(train, content, pictures)
    frames = _frames(train, content, pictures, size)
    if test is None:
        learn, check = _listed_split(content, frames)
    else:
        other = _load(test)
        others = _pictures(test, other)
        learn, check = frames, _frames(test, other, others, _known_size(test, other, others) or size)
    return Capture(train, "transforms", learn, check, np.eye(4), _points(train, content))


def _load(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_bytes())
    except OSError as error:
        raise InputError(file, f"can't be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise InputError(file, f"not valid JSON ({error})") from error
    if not isinstance(content, dict) or not isinstance(content.get("frames"), list):
        raise InputError(file, 'has no list "frames"', "is it a transforms.json?")
    if not content["frames"]:
        raise InputError(file, "lists no frames")
    for index, entry in enumerate(content["frames"]):
        if not isinstance(entry, dict):
            raise InputError(file, f"frame {index} is not an object")
        if not isinstance(entry.get("file_path"), str) or not entry["file_path"] or "\0" in entry["file_path"]:
            raise InputError(file, f'frame {index} has no "file_path"')
    return content


def _pictures(file: Path, content: dict[str, Any]) -> list[Path | None]:
    try:
        # Synthetic4Relight lists NAME for NAME_rgb.exr.
        bases = [file.parent / e["file_path"].replace("\\", "/") for e in content["frames"]]
        return [find_picture(b) or find_picture(b.with_name(b.name + "_rgb.exr")) for b in bases]
    except (OSError, ValueError) as error:  # names too long or otherwise impossible for the file system
        raise InputError(file, f"names an impossible file ({getattr(error, 'strerror', None) or error})") from error


def _known_size(file: Path, content: dict[str, Any], pictures: list[Path | None]) -> Size | None:
    """The size the cameras are for: as stated, or that of the first picture that can be read; None where there is neither."""
    if "w" in content and "h" in content:
        return _side(file, content, "w"), _side(file, content, "h")
    for picture in filter(None, pictures):
        try:
            return picture_size(picture)
        except InputError:
            continue  # reported when its turn to be decoded comes
    return None


def _frames(file: Path, content: dict[str, Any], pictures: list[Path | None], size: Size | None) -> list[Frame]:
    shared = {k: v for k, v in content.items() if k != "frames"}
    frames = []
    for index, (entry, picture) in enumerate(zip(content["frames"], pictures, strict=True)):
        where = f"{file}, frame {index} ({entry['file_path'][:80]})"
        lens = _lens(where, {**shared, **entry}, size)
        frames.append(Frame(entry["file_path"], picture, _mask(file, entry, picture), lens, _pose(where, entry)))
    return frames


def _mask(file: Path, entry: dict[str, Any], picture: Path | None) -> Path | None:
    if isinstance(entry.get("mask_path"), str) and entry["mask_path"]:
        mask = file.parent / entry["mask_path"].replace("\\", "/")
        if picture is not None and not mask.is_file():
            raise InputError(mask, "no such mask file", f"it is named by {file.name}")
        return mask
    if picture is None:
        return None
    # NAME_rgb.exr has its mask at NAME_mask.png.
    twin = picture.with_name(picture.stem.removesuffix("_rgb") + "_mask.png")
    return twin if twin != picture and twin.is_file() else find_mask(picture, _picture_root(file, picture))


def _picture_root(file: Path, picture: Path) -> Path:
    """The folder that the masks folder lies beside: the topmost folder of the picture's path below the file's own."""
    try:
        parts = picture.relative_to(file.parent).parts
    except ValueError:
        return picture.parent
    return file.parent / parts[0] if len(parts) > 1 else file.parent


def _pose(where: str, entry: dict[str, Any]) -> np.ndarray:
    """(4, 4) camera to world, made exactly rigid."""
    if "transform_matrix" not in entry:
        raise InputError(where, 'has no "transform_matrix"')
    try:
        matrix = np.array(entry["transform_matrix"], np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(where, "transform_matrix is not a matrix of numbers") from error
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0, 0, 0, 1]])
    if matrix.shape != (4, 4):
        raise InputError(where, f"transform_matrix has shape {matrix.shape}, not 4x4")
    return _rigid(where, matrix)


def _rigid(where: object, matrix: np.ndarray) -> np.ndarray:
    """The (4, 4) matrix with its rotation made exact. Raises InputError where it is not finite or not a rotation and a translation."""
    if not np.isfinite(matrix).all():
        raise InputError(where, "transform_matrix is not finite (NaN or infinity)")
    turn = matrix[:3, :3]
    if np.abs(turn).max() > 2 or np.abs(turn @ turn.T - np.eye(3)).max() > RIGID_TOLERANCE or np.linalg.det(turn) < 0:
        raise InputError(where, "transform_matrix is not rigid (scaled, sheared or mirrored)", "only rotation and translation are allowed")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > RIGID_TOLERANCE:
        raise InputError(where, "transform_matrix has a last row other than 0 0 0 1")
    if np.abs(matrix[:3, 3]).max() > FARTHEST:
        raise InputError(where, "transform_matrix puts the camera at infinity")
    u, _, vt = np.linalg.svd(turn)
    exact = np.eye(4)
    exact[:3, :3], exact[:3, 3] = u @ vt, matrix[:3, 3]
    return exact


def _lens(where: str, values: dict[str, Any], size: Size | None) -> Lens:
    """Intrinsics from the file's values, those of the frame first."""
    width, height = (_side(where, values, k, i, size) for i, k in enumerate(("w", "h")))
    if _given(values, "fl_x"):
        fx = _number(where, values, "fl_x")
        fy = _number(where, values, "fl_y") if _given(values, "fl_y") else fx
    elif _given(values, "camera_angle_x"):
        fx = _focal_of(where, values, "camera_angle_x", width)
        fy = _number(where, values, "fl_y") if _given(values, "fl_y") else fx
    else:
        raise InputError(where, 'has neither "fl_x" nor "camera_angle_x"')
    cx = _number(where, values, "cx") if _given(values, "cx") else width / 2
    cy = _number(where, values, "cy") if _given(values, "cy") else height / 2
    model, distortion, fisheye = _distortion(where, values)
    return Lens(model, width, height, fx, fy, cx, cy, distortion, fisheye).checked(where)


def _distortion(where: str, values: dict[str, Any]) -> tuple[str, tuple[float, ...], bool]:
    """(model name, coefficients in OpenCV's order, fisheye)."""
    k = {n: _number(where, values, n) if _given(values, n) else 0.0 for n in ("k1", "k2", "k3", "k4", "p1", "p2")}
    assumed = FISHEYE_MODEL if values.get("is_fisheye") is True else "OPENCV" if any(k.values()) else "PINHOLE"
    model = values.get("camera_model", assumed)
    if model == FISHEYE_MODEL:
        return model, (k["k1"], k["k2"], k["k3"], k["k4"]), True
    if model not in RADIAL_MODELS:
        known = ", ".join((*RADIAL_MODELS, FISHEYE_MODEL))
        raise InputError(where, f"has an unknown camera model {str(model)[:40]!r}", f"known are {known}")
    if k["k4"]:
        raise InputError(where, f"has k4 with the camera model {model}", "k4 belongs to OPENCV_FISHEYE")
    coefficients = (k["k1"], k["k2"], k["p1"], k["p2"], k["k3"])
    return model, coefficients if any(coefficients) and "PINHOLE" not in model else (), False


def _given(values: dict[str, Any], key: str) -> bool:
    return values.get(key) is not None


def _number(where: object, values: dict[str, Any], key: str) -> float:
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(where, f'"{key}" is not a number')
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(where, f'"{key}" is not finite')
    return number


def _side(where: object, values: dict[str, Any], key: str, axis: int = 0, size: Size | None = None) -> int:
    if not _given(values, key):
        if size is None:
            raise InputError(where, f'has no "{key}" and no picture to take the size from')
        return size[axis]
    side = _number(where, values, key)
    if not 1 <= side <= LARGEST_SIDE or side != int(side):
        raise InputError(where, f'"{key}" = {side:g} is not a picture size')
    return int(side)


def _focal_of(where: str, values: dict[str, Any], key: str, pixels: int) -> float:
    angle = _number(where, values, key)
    if not 0 < angle < math.pi:
        raise InputError(where, f'"{key}" = {angle:g} is not between 0 and pi')
    return 0.5 * pixels / math.tan(0.5 * angle)


def _listed_split(content: dict[str, Any], frames: list[Frame]) -> tuple[list[Frame], list[Frame] | None]:
    """Nerfstudio may name the pictures of each split inside the file."""
    named = {split: content.get(f"{split}_filenames") for split in ("train", "val", "test")}
    held = next((n for n in (named["test"], named["val"]) if isinstance(n, list) and n), None)
    if held is None:
        return frames, None
    chosen = {str(n) for n in held}
    learn = {str(n) for n in named["train"]} if isinstance(named["train"], list) else {f.listed for f in frames} - chosen
    return [f for f in frames if f.listed in learn], [f for f in frames if f.listed in chosen]


def _points(file: Path, content: dict[str, Any]) -> PointCloud | None:
    """Nerfstudio's sparse points, in the frame of the cameras."""
    name = content.get("ply_file_path")
    if not isinstance(name, str) or not name:
        return None
    path = file.parent / name
    if not path.is_file():
        raise InputError(path, "no such file", f"it is named by {file.name} as ply_file_path")
    try:
        vertex = PlyData.read(str(path))["vertex"]
        position = np.stack([vertex[c] for c in "xyz"], -1).astype(np.float32)
        names = {p.name for p in vertex.properties}
        colour = np.stack([vertex[c] for c in ("red", "green", "blue")], -1) if "red" in names else np.full(position.shape, 128, np.uint8)
    except Exception as error:  # plyfile raises many kinds for broken files
        raise InputError(path, f"not a readable PLY of points ({error})") from error
    if not (np.abs(position) < FARTHEST).all():
        raise InputError(path, "has points at infinity")
    return PointCloud(position, colour.astype(np.float32) / (255 if colour.dtype == np.uint8 else 1))
