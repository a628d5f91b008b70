# SPDX-License-Identifier: GPL-3.0-or-later
"""File cameras.json of a run: its cameras and the paths of their photographs, as JSON that needs no library to read."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.atomic import write_atomic
from ..io.quantisation import eight_bits
from .camera import Camera
from .dataset import Dataset, View


@dataclass(frozen=True, eq=False)
class PlacedCamera:
    """Camera of a run with its photograph.

    Attributes:
        name: of the view.
        split: "train" or "test".
        camera: the camera in the world.
        image: the photograph's file.
        light_rotation: (3, 3) from the world to the frame of the light, see `View`; None where the light stands still.
    """

    name: str
    split: str
    camera: Camera
    image: Path
    light_rotation: np.ndarray | None = None


def save_cameras(path: Path, dataset: Dataset) -> None:
    """Write the cameras of both splits of a dataset.

    Images inside the run folder are stored with relative paths, others with absolute ones. Photographs with lens distortion don't match
    their pinhole cameras: undistorted copies are written to `photographs/` next to `path`.

    Args:
        path: the cameras.json to write, in the run folder.
        dataset: the dataset of the run.
    """
    save_views(path, [("train", view) for view in dataset.train] + [("test", view) for view in dataset.test])


def save_views(path: Path, views: Iterable[tuple[str, View]]) -> None:
    """Write the cameras of views, as `save_cameras` does.

    Args:
        path: the cameras.json to write, in the run folder.
        views: (split, view) pairs, which are consumed one by one.
    """
    folder = path.parent.resolve()
    records = [_record(split, view, folder) for split, view in views]
    write_atomic(path, json.dumps(records, indent=1).encode())


def load_run_cameras(path: Path) -> list[PlacedCamera]:
    """Read the cameras that `save_cameras` wrote.

    Raises:
        InputError: if the file is missing or is not such a list.
    """
    try:
        return [_placed(record, path.parent) for record in json.loads(path.read_text(encoding="utf-8"))]
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(path, f"is not a list of cameras ({error!r})") from error


def _record(split: str, view: View, folder: Path) -> dict[str, object]:
    camera, image = view.camera, view.path.resolve()
    if view.distorted:
        image = folder / "photographs" / split / f"{view.name}.jpg"
        _save_undistorted(view, image)
    inside = image.is_relative_to(folder)
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
        "picture": (image.relative_to(folder) if inside else image).as_posix(),
        **({} if view.light_rotation is None else {"light_rotation": view.light_rotation.tolist()}),
    }


def _placed(record: dict, folder: Path) -> PlacedCamera:
    to_world = np.array(record["to_world"], float)
    if to_world.shape != (4, 4):
        raise ValueError(f"to_world has shape {to_world.shape}")
    lens = {name: float(record[name]) for name in ("fx", "fy", "cx", "cy")}
    camera = Camera(int(record["width"]), int(record["height"]), **lens, to_world=to_world)
    turned = np.array(record["light_rotation"], float) if "light_rotation" in record else None
    if turned is not None and turned.shape != (3, 3):
        raise ValueError(f"light_rotation has shape {turned.shape}")
    return PlacedCamera(str(record["name"]), str(record["split"]), camera, folder / record["picture"], turned)


def _save_undistorted(view: View, target: Path) -> None:
    from PIL import Image  # not available inside Blender, which only reads

    target.parent.mkdir(parents=True, exist_ok=True)
    data = io.BytesIO()
    Image.fromarray(eight_bits(view.colour)).save(data, "JPEG", quality=92)
    write_atomic(target, data.getvalue())
