# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of TensoIR's synthetic scenes: a folder for each view, with its camera, image and ground truth."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...settings.schema import DataSettings
from ..intrinsics import parse_lens
from ..parsed_dataset import Frame, ParsedDataset
from ..poses import rigid_pose

VIEW = re.compile(r"(train|test|val)_\d+")


def find_views(folder: Path) -> list[Path]:
    """Return the view folders of a TensoIR scene by name; empty if the folder is not one."""
    if not any(folder.glob("train_*/metadata.json")):
        return []
    return sorted(f for f in folder.iterdir() if VIEW.fullmatch(f.name) and (f / "metadata.json").is_file())


def read_tensoir(folder: Path, settings: DataSettings) -> ParsedDataset:
    """Read a TensoIR scene, whose frame is Blender's world.

    Args:
        folder: the scene's folder.
        settings: settings of the dataset.

    Raises:
        InputError: if a value is missing or not finite.
    """
    frames = {split: [_frame(v) for v in find_views(folder) if v.name.startswith(split)] for split in ("train", "test", "val")}
    return ParsedDataset(folder, folder, "tensoir", frames["train"], frames["test"] or frames["val"] or None, np.eye(4))


def _frame(view: Path) -> Frame:
    file = view / "metadata.json"
    try:
        meta = json.loads(file.read_bytes())
        matrix = np.array([float(v) for v in meta["cam_transform_mat"].split(",")])
        values = {"w": meta["imw"], "h": meta["imh"], "camera_angle_x": meta["cam_angle_x"]}
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(file, f"is not the description of a TensoIR view ({type(error).__name__}: {error})") from error
    if matrix.size != 16:
        raise InputError(file, f"cam_transform_mat has {matrix.size} numbers, not 16")
    image = view / "rgba.png"
    pose = rigid_pose(file, matrix.reshape(4, 4), "cam_transform_mat")
    return Frame(f"{view.name}/rgba", image if image.is_file() else None, None, parse_lens(str(file), values, None), pose)
