# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of NeRO's GlossyReal: photographs solved by COLMAP, with the object's points cut out by hand; no masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...io.image import image_size
from ...io.safe_paths import inside
from ...io.safe_pickle import read_pickle
from ...scene.camera import GL_TO_CV
from ...scene.dataset import Bound
from ...settings.schema import DataSettings
from ..bound import MARGIN
from ..parsed_dataset import Frame, Lens, ParsedDataset, find_image
from ..poses import rigid_pose
from ..sparse_points import read_points
from ..up_direction import estimate_up
from ..world_frame import approximate_camera, transform_world
from . import colmap

# Up and forward of the published scenes, which their files don't state; other scenes have them in meta_info.txt.
DIRECTIONS = {
    "bear": ((0.0512875, -0.645326, -0.762183), (0.539944, -0.342791, 0.341446)),
    "bunny": ((-0.0693234, -0.644819, -0.761185), (0.437076, -1.672467, 1.436961)),
    "coral": ((0.0477973, -0.748313, -0.661622), (0.004226, -0.235523, 0.267582)),
    "maneki": ((-0.0117387, -0.738751, -0.673876), (-2.336584, -0.406351, 0.482029)),
    "vase": ((-0.01911, -0.738918, -0.673524), (-0.911907, -0.132777, 0.180063)),
}
ASKEW = 0.7  # cosine of the angle to the cameras' up beyond which the table's up belongs to another scene of the same name


def find_object_points(folder: Path) -> Path | None:
    """Return the file of the object's points of a GlossyReal scene, or None if the folder is not one."""
    file = folder / "object_point_cloud.ply"
    solved = colmap.find_model(folder) is not None or (folder / "cache.pkl").is_file()
    return file if file.is_file() and solved else None


def read_glossy_real(folder: Path, settings: DataSettings) -> ParsedDataset:
    """Read a GlossyReal scene in NeRO's normalised frame: +Z up, the object's box around the origin, its farthest point at distance 1.

    Cameras are read from the COLMAP model, or from NeRO's own copy, cache.pkl, if there is no model.

    Args:
        folder: the scene's folder.
        settings: settings of the dataset.

    Raises:
        InputError: if a file is missing or damaged.
    """
    file, model = find_object_points(folder), colmap.find_model(folder)
    assert file is not None
    cloud = read_points(file)
    if model is not None:
        frames, points, root, warnings = colmap.read_frames(model, settings.resolution)
    else:
        frames, points, root, warnings = _cached_frames(folder / "cache.pkl"), None, folder, []
    parsed = ParsedDataset(model or folder, root, "glossy-real", frames, None, np.eye(4), points or cloud, warnings=warnings)
    low, high = cloud.position.min(0).astype(np.float64), cloud.position.max(0).astype(np.float64)
    centre = (low + high) / 2
    size = 1 / max(float(np.linalg.norm(cloud.position - centre, axis=-1).max()), 1e-12)
    normalise = np.eye(4)
    normalise[:3, :3] = size * _axes(folder, frames)
    normalise[:3, 3] = -normalise[:3, :3] @ centre
    return replace(transform_world(parsed, normalise), bound=Bound((0.0, 0.0, 0.0), MARGIN))


def _axes(folder: Path, frames: list[Frame]) -> np.ndarray:
    """Return the rotation (3, 3) from the model's frame to one with +Z up and the scene's forward along +X."""
    estimate = estimate_up([approximate_camera(f) for f in frames])
    up, forward = _directions(folder)
    if np.linalg.norm(np.cross(up, forward)) < 1e-6 or up @ estimate < ASKEW * np.linalg.norm(up):
        up, forward = estimate, np.eye(3)[np.abs(estimate).argmin()]
    up = up / np.linalg.norm(up)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    return np.stack([np.cross(left, up), left, up])


def _directions(folder: Path) -> np.ndarray:
    """Return up and forward (2, 3) as stated for the scene, or zeros."""
    file = folder / "meta_info.txt"
    if not file.is_file():
        return np.array(DIRECTIONS.get(folder.resolve().name, np.zeros((2, 3))), np.float64)
    try:
        rows = np.loadtxt(file, max_rows=2)
    except (OSError, ValueError) as error:
        raise InputError(file, f"does not hold two directions ({error})") from error
    if rows.shape != (2, 3) or not np.isfinite(rows).all():
        raise InputError(file, "does not hold two directions, up and forward")
    return rows


def _cached_frames(file: Path) -> list[Frame]:
    content = read_pickle(file)
    if not (isinstance(content, list) and len(content) == 4 and all(isinstance(part, dict) for part in content[:3])):
        raise InputError(file, "does not hold poses, intrinsics, names and numbers of images")
    poses, intrinsics, names, numbers = content
    try:
        rows = [(str(names[n]), np.array(poses[n], np.float64), np.array(intrinsics[n], np.float64)) for n in numbers]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(file, f"has an image without a camera ({error})") from error
    return [_cached_frame(file, *row) for row in sorted(rows, key=lambda row: row[0])]


def _cached_frame(file: Path, name: str, pose: np.ndarray, k: np.ndarray) -> Frame:
    where = f"{file}, {name[:80]}"
    if k.shape != (3, 3):
        raise InputError(where, "has no 3x3 matrix of intrinsics")
    image = find_image(inside(file.parent / "images" / name, file.parent))
    # NeRO's principal point is the middle of the image.
    width, height = image_size(image) if image else (round(2 * float(k[0, 2])), round(2 * float(k[1, 2])))
    numbers: Any = [float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))]
    lens = Lens("PINHOLE", width, height, *numbers).checked(where)
    return Frame(name, image, None, lens, np.linalg.inv(rigid_pose(where, pose, "the pose")) @ GL_TO_CV)
