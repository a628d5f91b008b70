# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of a run and where their photographs are, as JSON that needs no library to read."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..datasets.camera import Camera
from ..datasets.dataset import Dataset, View
from ..errors import InputError


@dataclass(frozen=True, eq=False)
class PlacedCamera:
    """A camera of a run: the frame's `name`, its `split` ("train" or "test"), the camera in the world, the photograph's file."""

    name: str
    split: str
    camera: Camera
    picture: Path


def save_cameras(path: Path, dataset: Dataset) -> None:
    """Write the cameras of both splits; pictures inside the run folder are named relative to it, others absolutely."""
    folder = path.parent.resolve()
    views = [("train", view) for view in dataset.train] + [("test", view) for view in dataset.test]
    text = json.dumps([_record(split, view, folder) for split, view in views], indent=1)
    partial = path.with_name(path.name + ".part")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def load_cameras(path: Path) -> list[PlacedCamera]:
    """Read what `save_cameras` wrote. Raises InputError where the file is missing or not of that form."""
    try:
        return [_placed(record, path.parent) for record in json.loads(path.read_text(encoding="utf-8"))]
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(path, f"is not a list of cameras ({error!r})") from error


def _record(split: str, view: View, folder: Path) -> dict[str, object]:
    camera, picture = view.camera, view.path.resolve()
    inside = picture.is_relative_to(folder)
    return {
        "name": view.name,
        "split": split,
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "to_world": camera.to_world.tolist(),
        "picture": (picture.relative_to(folder) if inside else picture).as_posix(),
    }


def _placed(record: dict, folder: Path) -> PlacedCamera:
    to_world = np.array(record["to_world"], float)
    if to_world.shape != (4, 4):
        raise ValueError(f"to_world has shape {to_world.shape}")
    lens = {name: float(record[name]) for name in ("fx", "fy", "cx", "cy")}
    camera = Camera(int(record["width"]), int(record["height"]), **lens, to_world=to_world)
    return PlacedCamera(str(record["name"]), str(record["split"]), camera, folder / record["picture"])
