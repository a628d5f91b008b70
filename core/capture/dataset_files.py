# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a captured dataset: COLMAP model, transforms.json, cameras.json, masks, exposures.json."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from ..errors import InputError
from ..io.atomic import replaced_folder, write_atomic
from ..io.quantisation import eight_bits
from ..scene.camera import Camera
from ..scene.similarity import moved_points
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
    reconstruction = pycolmap.Reconstruction()
    numbers: dict[tuple[float, ...], int] = {}
    order = np.lexsort((model.track_point, model.track_photograph))
    starts = np.searchsorted(model.track_photograph[order], np.arange(len(images) + 1))
    elements: list[list[pycolmap.TrackElement]] = [[] for _ in model.position]
    for i, one in enumerate(images):
        observations = order[starts[i] : starts[i + 1]]
        pixels = undistorted_pixels(model.track_pixel[observations], one.posed.lens)
        camera = _camera_number(reconstruction, numbers, one.camera)
        image = pycolmap.Image(name=one.image.name, keypoints=pixels, camera_id=camera, image_id=i + 1)
        pose = pycolmap.Rigid3d(one.camera.moved(similarity).world_to_cv[:3])
        reconstruction.add_image_with_trivial_frame(image, pose)
        for j, point in enumerate(model.track_point[observations]):
            elements[point].append(pycolmap.TrackElement(i + 1, j))
    for place, colour, seen in zip(moved_points(model.position, similarity), model.colour, elements, strict=True):
        reconstruction.add_point3D(place, pycolmap.Track(seen), colour)
    with replaced_folder(folder / MODEL) as partial:
        reconstruction.write(partial)


def _camera_number(reconstruction: pycolmap.Reconstruction, numbers: dict[tuple[float, ...], int], camera: Camera) -> int:
    """Return the number of a pinhole camera in the reconstruction, which is added where it is new."""
    key = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    if key not in numbers:
        numbers[key] = len(numbers) + 1
        added = pycolmap.Camera(
            camera_id=numbers[key], model="PINHOLE", width=camera.width, height=camera.height, params=np.array(key[2:], np.float64)
        )
        reconstruction.add_camera_with_trivial_rig(added)
    return numbers[key]


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
