# SPDX-License-Identifier: GPL-3.0-or-later
"""Preparation of frames for decoding: view names, and lenses and cameras at the sizes of the images."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

from ..errors import InputError
from ..io.image import image_size
from ..scene.camera import Camera
from ..settings.schema import DataSettings
from .parsed_dataset import Frame, Lens, view_names
from .undistort import pinhole

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class PreparedFrame:
    """Frame with its view name, its lens at the size that the image is used at, and the pinhole camera of the undistorted image."""

    frame: Frame
    name: str
    lens: Lens
    camera: Camera


def prepare_frames(frames: list[Frame], settings: DataSettings, warnings: list[str]) -> list[PreparedFrame]:
    """Determine the view names and final cameras of frames; the headers of their images are read and checked against the cameras.

    Args:
        frames: frames of one split.
        settings: settings of the dataset.
        warnings: a warning is appended if the images are smaller than their cameras.

    Raises:
        InputError: if an image and its camera don't match, or a lens distortion is impossible.
    """
    sizes = _in_threads(_image_size, frames)
    fitted = _fitted_lenses(frames, sizes, warnings)
    prepared = []
    for frame, name, lens in zip(frames, view_names([f.listed for f in frames]), fitted, strict=True):
        lens = _reduced(lens, settings.resolution)
        try:
            p = pinhole(lens)
        except InputError as error:
            raise InputError(frame.image or frame.listed, f"{error.where} {error.what}", error.fix) from error
        prepared.append(PreparedFrame(frame, name, lens, Camera(p.width, p.height, p.fx, p.fy, p.cx, p.cy, frame.to_world)))
    return prepared


def _image_size(frame: Frame) -> tuple[int, int]:
    """Return the size of the frame's image; the camera's if the image is missing or broken, which decoding reports."""
    try:
        return image_size(frame.image) if frame.image else frame.lens.size
    except InputError:
        return frame.lens.size


def _fitted_lenses(frames: list[Frame], sizes: list[tuple[int, int]], warnings: list[str]) -> list[Lens]:
    """Return each frame's lens at the size of its image.

    A size other than the camera's is valid only if all images of that camera are the same uniform reduction; otherwise image and camera
    don't match, which raises InputError.
    """
    by_lens: dict[Lens, set[tuple[int, int]]] = {}
    for frame, size in zip(frames, sizes, strict=True):
        by_lens.setdefault(frame.lens, set()).add(size)
    for frame, size in zip(frames, sizes, strict=True):
        if size != frame.lens.size and (len(by_lens[frame.lens]) > 1 or not is_reduction(frame.lens.size, size)):
            camera = f"{frame.lens.width}x{frame.lens.height}"
            raise InputError(frame.image or frame.listed, f"is {size[0]}x{size[1]} but its camera is {camera}")
    for lens, found in by_lens.items():
        size = next(iter(found))
        if size != lens.size:
            line = f"images are {size[0]}x{size[1]}, their camera {lens.width}x{lens.height}: intrinsics are scaled"
            warnings.extend([line] if line not in warnings else [])
    return [f.lens.resized(*s) if s != f.lens.size else f.lens for f, s in zip(frames, sizes, strict=True)]


def is_reduction(full: tuple[int, int], small: tuple[int, int]) -> bool:
    """Return True if one size is the other divided by a number >= 1.1, each side rounded up or down; a few pixels less are a crop.

    Args:
        full: (width, height) in pixels.
        small: (width, height) in pixels.
    """
    smaller = 1.1 * small[0] <= full[0] and 1.1 * small[1] <= full[1]
    return smaller and abs(small[0] * full[1] - small[1] * full[0]) <= max(full)


def _reduced(lens: Lens, resolution: int) -> Lens:
    scale = resolution / max(lens.size)
    return lens if scale >= 1 else lens.resized(max(1, round(lens.width * scale)), max(1, round(lens.height * scale)))


def decoding_threads() -> int:
    """Return the number of threads that read images."""
    return min(8, os.cpu_count() or 1)


def _in_threads(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    with ThreadPoolExecutor(decoding_threads()) as pool:
        return list(pool.map(work, items))
