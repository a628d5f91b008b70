# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a captured dataset: COLMAP model, transforms.json, cameras.json, masks, exposures.json."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from ..errors import InputError
from ..io.atomic import replaced_folder, write_atomic
from ..io.quantisation import eight_bits
from ..scene.similarity import moved_points
from .reconstruction import Tracks, build_reconstruction
from .sparse_model import SparseModel
from .undistortion import UndistortedImage, undistorted_pixels

MODEL = "sparse/0"


def write_model(model: SparseModel, images: Sequence[UndistortedImage], similarity: np.ndarray, folder: Path) -> None:
    """Write the COLMAP model of the undistorted images to `folder/sparse/0`, in the world.

    Args:
        model: sparse model in its own frame.
        images: V undistorted images of `model.posed`.
        similarity: (4, 4) from the model's frame to the world.
        folder: folder of the capture.
    """
    track_pixel = np.zeros_like(model.track_pixel, np.float64)
    for i, one in enumerate(images):
        own = model.track_photograph == i
        track_pixel[own] = undistorted_pixels(model.track_pixel[own], one.posed.lens)
    tracks = Tracks(moved_points(model.position, similarity), model.colour, model.track_point, model.track_photograph, track_pixel)
    cameras = [one.camera.moved(similarity) for one in images]
    reconstruction = build_reconstruction([one.image.name for one in images], cameras, tracks)
    with replaced_folder(folder / MODEL) as partial:
        reconstruction.write(partial)


def write_masks(images: Sequence[UndistortedImage], masks: Sequence[np.ndarray | None], folder: Path) -> None:
    """Write masks to `folder/masks` as 8-bit PNG files of the images' full size; those of an earlier start are removed.

    Args:
        images: V undistorted images.
        masks: V masks (H, W) in 0..1, of the views' size, or None.
        folder: folder of the capture.
    """
    target = folder / "masks"
    shutil.rmtree(target, ignore_errors=True)
    if all(mask is None for mask in masks):
        return
    target.mkdir()
    for one, mask in zip(images, masks, strict=True):
        if mask is not None:
            full = cv2.resize(mask.astype(np.float32), (one.camera.width, one.camera.height), interpolation=cv2.INTER_CUBIC)
            _, data = cv2.imencode(".png", eight_bits(full))
            write_atomic(target / f"{one.view.name}.png", data.tobytes())


def write_transforms(
    images: Sequence[UndistortedImage],
    similarity: np.ndarray,
    masked: Sequence[bool],
    folder: Path,
    rotations: dict[str, list[list[float]]] | None = None,
) -> None:
    """Write transforms.json (nerfstudio's layout) and cameras.json (as in run folders), in the world.

    Args:
        images: V undistorted images.
        similarity: (4, 4) from the model's frame to the world.
        masked: V flags of images with a mask file.
        folder: folder of the capture.
        rotations: rotation from the world to the frame of the light by the view's name; None where the light stands still.
    """
    frames, records = [], []
    for one, has_mask in zip(images, masked, strict=True):
        camera = one.camera.moved(similarity)
        pose, file = camera.to_world.tolist(), one.image.relative_to(folder).as_posix()
        lens = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
        mask = {"mask_path": f"masks/{one.view.name}.png"} if has_mask else {}
        light = {} if rotations is None else {"light_rotation": rotations[one.view.name]}
        frames.append({"file_path": file, **mask, **lens, "transform_matrix": pose, **light})
        sizes = {"width": camera.width, "height": camera.height}
        focal = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy}
        records.append({"name": one.view.name, "split": "train", **sizes, **focal, "to_world": pose, "picture": file})
    write_json(folder / "transforms.json", {"camera_model": "OPENCV", "frames": frames})
    write_json(folder / "cameras.json", records)


def write_json(path: Path, content: object) -> None:
    """Write a JSON file atomically.

    Args:
        path: the file.
        content: plain values.

    Raises:
        InputError: if the folder can't be written.
    """
    try:
        write_atomic(path, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())
    except OSError as error:
        raise InputError(path, f"can't be written ({error.strerror})") from error
