# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of the transforms.json family: NeRF-synthetic, instant-ngp, nerfstudio."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...io.image import image_size
from ...io.safe_paths import inside, is_file
from ...scene.dataset import PointCloud
from ...settings.schema import DataSettings
from ..intrinsics import Size, parse_lens, parse_side
from ..parsed_dataset import Frame, ParsedDataset, find_image, find_mask
from ..poses import parse_light_rotation, parse_pose
from ..sparse_points import read_points

NERFSTUDIO_KEYS = ("camera_model", "ply_file_path", "applied_transform", "orientation_override", "train_filenames")
TENSOIR_VIEW = re.compile(r"(train|test|val)_\d+/rgba(\.png)?")
GLOSSY_VIEW = re.compile(r"rgb/\d+(\.png)?")  # GlossySynthetic scenes as converted by Ref-Gaussian and related methods


def read_transforms(file: Path, settings: DataSettings) -> ParsedDataset:
    """Read a transforms file, and that of the test views if the dataset has one; its frame is the world (+Z up by convention).

    Args:
        file: the transforms file.
        settings: settings of the dataset.

    Raises:
        InputError: if a value is missing, not finite or not rigid.
    """
    content, test = load_transforms(file), _test_file(file)
    images = [find_listed_image(file.parent, e["file_path"]) for e in content["frames"]]
    size = _known_size(file, content, images)
    images = _downscaled(file.parent, content, images, size, settings.resolution)
    frames = parse_frames(file, content, images, size)
    if test is None:
        train_frames, test_frames = _listed_split(content, frames)
    else:
        other = load_transforms(test)
        others = [find_listed_image(test.parent, e["file_path"]) for e in other["frames"]]
        train_frames, test_frames = frames, parse_frames(test, other, others, _known_size(test, other, others) or size)
    if not train_frames:
        raise InputError(file, "has no training views", "all of its frames are test views, or none is listed in train_filenames")
    format = detect_format(file, content, train_frames)
    return ParsedDataset(file, file.parent, format, train_frames, test_frames, np.eye(4), _points(file, content))


def detect_format(file: Path, content: dict[str, Any], frames: list[Frame]) -> str:
    """Detect the short name of the format that a transforms file belongs to.

    Args:
        file: the file, whose neighbours are looked at.
        content: its content.
        frames: its training frames.
    """
    folder, first = file.parent, next((f for f in frames if f.image is not None), frames[0])
    listed = first.listed.removeprefix("./")
    if (folder / "meta.json").is_file():  # rendered by scripts/render_dataset.py
        return "transforms"
    if (folder / "transforms_novel.json").is_file() or (folder / "train_mask").is_dir():
        return "stanford-orb"
    if first.image is not None and first.image.name.endswith("_rgb.exr"):
        return "synthetic4relight"
    if TENSOIR_VIEW.fullmatch(listed):
        return "tensoir"
    if file.name == "transforms_train.json" and GLOSSY_VIEW.fullmatch(listed) and "fl_x" in content:
        return "glossy-synthetic"
    if file.name == "transforms_train.json" and "camera_angle_x" in content and "fl_x" not in content:
        return "nerf-synthetic"
    if "aabb_scale" in content:
        return "instant-ngp"
    return "nerfstudio" if any(key in content for key in NERFSTUDIO_KEYS) else "transforms"


def _test_file(train: Path) -> Path | None:
    """Return the file of the test views that belongs to a file of training views, or None."""
    if train.name != "transforms_train.json":
        return None
    files = (train.with_name(f"transforms_{split}.json") for split in ("test", "val"))
    return next((f for f in files if f.is_file()), None)


def load_transforms(file: Path) -> dict[str, Any]:
    """Read the content of a transforms file, and check that each of its frames has a `file_path`.

    Raises:
        InputError: if the file can't be read or is not a transforms file.
    """
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


def find_listed_image(folder: Path, listed: str) -> Path | None:
    """Find the image that a transforms file lists.

    Args:
        folder: the folder of the transforms file.
        listed: name of the image in the file.

    Returns:
        The image, or None if it does not exist.

    Raises:
        InputError: if it would be outside of the folder, or is not a possible file name.
    """
    base = folder / listed.replace("\\", "/")
    try:
        inside(base, folder)
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            base.lstat()
        # Synthetic4Relight lists NAME for NAME_rgb.exr and NAME_rgba.png.
        candidates = (base, base.with_name(base.name + "_rgb.exr"), base.with_name(base.name + "_rgba.png"))
        return next(filter(None, map(find_image, candidates)), None)
    except (OSError, ValueError) as error:  # names too long or otherwise impossible for the file system
        reason = getattr(error, "strerror", None) or error
        raise InputError(folder, f"a frame lists the impossible file {listed[:80]!r} ({reason})") from error


def _downscaled(folder: Path, content: dict[str, Any], images: list[Path | None], size: Size | None, resolution: int) -> list[Path | None]:
    """Return nerfstudio's smaller copies of all images, from images_2, images_4 or images_8, if they reach the resolution."""
    names = [e["file_path"].removeprefix("./") for e in content["frames"]]
    if size is None or not all(n.startswith("images/") for n in names):
        return images
    for factor in (8, 4, 2):
        small = folder / f"images_{factor}"
        if max(size) / factor >= resolution and small.is_dir():
            copies = [find_listed_image(folder, f"images_{factor}/" + n.removeprefix("images/")) for n in names]
            if all(c is not None or p is None for c, p in zip(copies, images, strict=True)):
                return copies
    return images


def _known_size(file: Path, content: dict[str, Any], images: list[Path | None]) -> Size | None:
    """Return the image size of the cameras: as stated, or that of the first image that can be read; None if there is neither."""
    if "w" in content and "h" in content:
        return parse_side(file, content, "w"), parse_side(file, content, "h")
    for image in filter(None, images):
        try:
            return image_size(image)
        except InputError:
            continue  # reported when it is decoded
    return None


def parse_frames(file: Path, content: dict[str, Any], images: list[Path | None], size: Size | None) -> list[Frame]:
    """Parse the frames of a transforms file.

    Args:
        file: the file, for messages and as the place of masks.
        content: its content.
        images: the image of each frame, or None.
        size: (width, height) in pixels of cameras that don't state theirs.

    Raises:
        InputError: if a camera is incomplete or impossible.
    """
    shared = {k: v for k, v in content.items() if k != "frames"}
    frames = []
    for index, (entry, image) in enumerate(zip(content["frames"], images, strict=True)):
        where = f"{file}, frame {index} ({entry['file_path'][:80]})"
        lens = parse_lens(where, {**shared, **entry}, size)
        rotation = parse_light_rotation(where, entry.get("light_rotation"))
        pose, mask = parse_pose(where, entry), _mask(file, entry, image)
        frames.append(Frame(entry["file_path"], image, mask, lens, pose, light_rotation=rotation))
    return frames


def _mask(file: Path, entry: dict[str, Any], image: Path | None) -> Path | None:
    if isinstance(entry.get("mask_path"), str) and entry["mask_path"]:
        mask = inside(file.parent / entry["mask_path"].replace("\\", "/"), file.parent)
        if image is not None and not is_file(mask):
            raise InputError(mask, "no such mask file", f"it is named by {file.name}")
        return mask
    if image is None:
        return None
    # NAME_rgb.exr has its mask at NAME_mask.png.
    mask = image.with_name(image.stem.removesuffix("_rgb") + "_mask.png")
    return mask if mask != image and is_file(mask) else find_mask(image, _image_root(file, image))


def _image_root(file: Path, image: Path) -> Path:
    """Return the folder that the folder of masks is next to: the topmost folder of the image's path below that of the file."""
    try:
        parts = image.relative_to(file.parent).parts
    except ValueError:
        return image.parent
    return file.parent / parts[0] if len(parts) > 1 else file.parent


def _listed_split(content: dict[str, Any], frames: list[Frame]) -> tuple[list[Frame], list[Frame] | None]:
    """Split frames as nerfstudio's lists of file names state; test frames are None if there is no such list."""
    lists = {split: content.get(f"{split}_filenames") for split in ("train", "val", "test")}
    held_out = next((n for n in (lists["test"], lists["val"]) if isinstance(n, list) and n), None)
    if held_out is None:
        return frames, None
    test = {str(n) for n in held_out}
    train = {str(n) for n in lists["train"]} if isinstance(lists["train"], list) else {f.listed for f in frames} - test
    return [f for f in frames if f.listed in train], [f for f in frames if f.listed in test]


def _points(file: Path, content: dict[str, Any]) -> PointCloud | None:
    """Read nerfstudio's sparse points, in the frame of the cameras; None if the file names none."""
    name = content.get("ply_file_path")
    if not isinstance(name, str) or not name:
        return None
    path = inside(file.parent / name.replace("\\", "/"), file.parent)
    if not is_file(path):
        raise InputError(path, "no such file", f"it is named by {file.name} as ply_file_path")
    return read_points(path)
