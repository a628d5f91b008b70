# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of NeRO's GlossySynthetic: pickled cameras, depth maps as masks, a world with +Y up, and relit images in other folders."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...io.image import image_size
from ...io.safe_paths import inside
from ...io.safe_pickle import read_pickle
from ...scene.camera import GL_TO_CV
from ...settings.schema import DataSettings
from ..parsed_dataset import Frame, Lens, ParsedDataset
from ..poses import rigid_pose
from ..world_frame import transform_world

DEPTH_RANGE = 15.0  # depth of the largest integer of a depth map
FAR = 14.5  # depth from which on there is background
CAMERA = re.compile(r"(\d+)-camera\.pkl")
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # (x, y, z) to Blender's (x, -z, y)
SPLIT = "synthetic_split_128.pkl"
# The test views of NeRO's split of 128 views, which that file holds.
NERO_TEST = (0, 2, 3, 4, 5, 7, 11, 14, 19, 29, 30, 31, 33, 49, 56, 57, 59, 61, 66, 68, 71, 73, 75, 91, 93, 95, 109, 110, 111, 113, 120, 127)


def find_camera_files(folder: Path) -> list[Path]:
    """Return the camera files of a GlossySynthetic scene by number; empty if the folder is not one."""
    files = [f for f in folder.glob("*-camera.pkl") if CAMERA.fullmatch(f.name)]
    return sorted(files, key=lambda f: int(f.name.split("-")[0]))


def read_glossy_synthetic(folder: Path, settings: DataSettings) -> ParsedDataset:
    """Read a GlossySynthetic scene.

    Every `holdout`-th view is a test view (Ref-Gaussian's split), unless NeRO's file of its split is in the folder or next to it.

    Args:
        folder: the scene's folder.
        settings: settings of the dataset.

    Raises:
        InputError: if a camera is damaged, or a pickle holds anything but arrays.
    """
    frames = [_frame(f) for f in find_camera_files(folder)]
    file = next((f for f in (folder / SPLIT, folder.parent / SPLIT) if f.is_file()), None)
    chosen = {f"{n}.png" for n in (NERO_TEST if file is None else _test_ids(file))}
    train, test = [f for f in frames if f.listed not in chosen], [f for f in frames if f.listed in chosen]
    declared = (frames, None) if file is None else (train, test)
    published = frozenset(f.listed for f in test) if file is not None or len(frames) == 128 else frozenset()
    return to_z_up(ParsedDataset(folder, folder, "glossy-synthetic", *declared, np.eye(4), published=published, novel=_novel(folder)))


def to_z_up(parsed: ParsedDataset) -> ParsedDataset:
    """Rotate a scene from its own +Y-up frame to the world (+Z up)."""
    return transform_world(parsed, Y_UP)


def relit_folders(folder: Path) -> dict[str, Path]:
    """Find the folders of a scene's relit images by light: relight_gt/SCENE_LIGHT next to the scene or one level above."""
    prefix = folder.resolve().name.removesuffix("_blender") + "_"
    for parent in list(folder.resolve().parents)[:2]:
        for place in (parent / "relight_gt", parent / "glossy_relight" / "relight_gt"):
            relit = [f for f in sorted(place.glob("*")) if f.name.startswith(prefix) and f.is_dir()]
            found = {f.name.removeprefix(prefix): inside(f, place) for f in relit}
            if found:
                return found
    return {}


def light_files(folder: Path) -> dict[str, Path]:
    """Find the environment maps of a scene's relit images by light (in hdr2k next to relight_gt), in Blender's frame."""
    files = {light: relit.parent.parent / "hdr2k" / f"{light}.exr" for light, relit in relit_folders(folder).items()}
    return {light: inside(file, file.parent) for light, file in files.items() if file.is_file()}


def depth_map_of(image: Path) -> Path:
    """Return the path of an image's depth map."""
    return image.with_name(image.stem + "-depth.png")


def _novel(folder: Path) -> list[Frame]:
    """Read the views under other lights; their cameras are those next to the images, or else those of the scene."""
    frames = []
    for light, relit in relit_folders(folder).items():
        cameras = find_camera_files(relit)
        cameras = cameras or [f for f in find_camera_files(folder) if (relit / f"{f.name.split('-')[0]}.png").is_file()]
        frames += [_frame(camera, relit, light) for camera in cameras]
    return frames


def _frame(camera: Path, folder: Path | None = None, light: str | None = None) -> Frame:
    number, place = camera.name.split("-")[0], folder or camera.parent
    matrix, intrinsics = _arrays(camera)
    to_world = np.linalg.inv(rigid_pose(camera, matrix, "the pose")) @ GL_TO_CV
    image = inside(place / f"{number}.png", place)
    exists = image.is_file()
    width, height = image_size(image) if exists else (round(2 * intrinsics[0, 2]), round(2 * intrinsics[1, 2]))
    fx, fy, cx, cy = (float(intrinsics[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    lens = Lens("PINHOLE", width, height, fx, fy, cx, cy).checked(camera)
    depth = depth_map_of(image)
    listed = image.name if light is None else f"{place.name}/{image.name}"
    return Frame(listed, image if exists else None, depth if depth.is_file() else None, lens, to_world, FAR / DEPTH_RANGE, light)


def _arrays(camera: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the pose (3, 4), world to camera in OpenCV's axes, and the intrinsics (3, 3) of a camera file."""
    content = read_pickle(camera)
    if isinstance(content, (list, tuple)) and len(content) == 2 and all(isinstance(a, np.ndarray) for a in content):
        pose, intrinsics = content
        if pose.shape == (3, 4) and intrinsics.shape == (3, 3) and pose.dtype.kind == "f" and intrinsics.dtype.kind in "fi":
            return pose.astype(np.float64), intrinsics.astype(np.float64)
    raise InputError(camera, "does not hold a 3x4 pose and a 3x3 matrix of intrinsics")


def _test_ids(file: Path) -> list[int]:
    content = read_pickle(file)
    try:
        test, _ = content
        return [int(n) for n in test]
    except (TypeError, ValueError) as error:
        raise InputError(file, "does not hold the numbers of test and training views") from error
