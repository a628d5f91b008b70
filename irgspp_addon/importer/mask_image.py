# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks of a captured dataset as images to paint on: the photograph, opaque where the mask says object and dim elsewhere.

The mask is the image's alpha channel, raised by DIM so that the photograph is visible outside the object too. Blender's brushes
Erase Alpha and Add Alpha change it; `save_masks` writes it back to the mask's file.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.io.atomic import atomic_file
from ...core.io.quantisation import eight_bits
from .capture_file import FILE
from .ownership import KEY, folder_of

MASK, DIGEST = "irgspp_mask", "irgspp_mask_digest"  # custom properties of the image: the mask's file, and its content when last saved
DIM = 77 / 255  # alpha outside the object, a value of 8 bits


def is_captured_camera(thing: bpy.types.Object | None) -> bool:
    """Return True for an imported camera of a captured dataset."""
    folder = folder_of(thing)
    return folder is not None and thing is not None and thing.type == "CAMERA" and (folder / FILE).is_file()


def open_mask(camera: bpy.types.Object) -> bpy.types.Image:
    """Return the image to paint the mask of a camera's photograph on; without a mask file all of it is object.

    Args:
        camera: imported camera of a captured dataset.

    Raises:
        InputError: if the photograph is missing or the mask has another size.
    """
    photograph, file = _files(camera)
    known = next((image for image in bpy.data.images if image.get(MASK) == str(file)), None)
    if known is not None and _is_painted(known):
        return known
    pixels = _pixels(photograph)
    mask = _mask(file) if file.is_file() else np.ones(pixels.shape[:2], np.float32)
    if mask.shape != pixels.shape[:2]:
        raise InputError(file, "is not of its photograph's size", "delete the mask, or capture again")
    pixels[..., 3] = DIM + (1 - DIM) * mask
    image = known or bpy.data.images.new(f"{photograph.stem} mask", pixels.shape[1], pixels.shape[0], alpha=True)
    image.pixels.foreach_set(pixels.reshape(-1))
    image.update()
    image[MASK], image[DIGEST] = str(file), _digest(_painted(image))
    return image


def opened_masks() -> list[bpy.types.Image]:
    """Return the images of masks that were opened in this session."""
    return [image for image in bpy.data.images if MASK in image and image.is_dirty]


def save_masks() -> list[Path]:
    """Write the masks that were painted on since they were opened or saved last, and return their files.

    Raises:
        InputError: if a file can't be written.
    """
    written = []
    for image in opened_masks():
        mask = _painted(image)
        if image.get(DIGEST) != _digest(mask):
            _write(mask, Path(image[MASK]))
            image[DIGEST] = _digest(mask)
            written.append(Path(image[MASK]))
    return written


def _files(camera: bpy.types.Object) -> tuple[Path, Path]:
    """Return the photograph of a camera and its mask's file, in `images` and `masks` of the captured dataset."""
    folder = folder_of(camera)
    if folder is None or not is_captured_camera(camera):
        raise InputError(camera.name, "is not a camera of a captured dataset", "select one that Find Cameras has imported")
    name = camera[KEY].partition("#camera ")[2].partition(" ")[2]
    images = folder / "images"
    found = [file for file in images.iterdir() if file.stem == name] if images.is_dir() else []
    if not found:
        raise InputError(images, f"has no photograph {name}", "capture the photographs again")
    return found[0], folder / "masks" / f"{name}.png"


def _is_painted(image: bpy.types.Image) -> bool:
    return image.is_dirty and image.get(DIGEST) != _digest(_painted(image))


def _painted(image: bpy.types.Image) -> np.ndarray:
    """Return the mask (H, W) uint8 that an image's alpha stands for, bottom row first as in Blender."""
    values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
    image.pixels.foreach_get(values)
    alpha = values.reshape(image.size[1], image.size[0], -1)[..., 3]
    return eight_bits((alpha - DIM) / (1 - DIM))


def _digest(mask: np.ndarray) -> str:
    return hashlib.sha1(mask.tobytes(), usedforsecurity=False).hexdigest()


def _pixels(file: Path) -> np.ndarray:
    """Read an image file as stored: (H, W, 4) float32, bottom row first."""
    try:
        image = bpy.data.images.load(str(file))
    except RuntimeError as error:
        raise InputError(file, f"can't be read ({error})") from error
    try:
        image.colorspace_settings.name = "Non-Color"
        if not image.size[0]:
            raise InputError(file, "is not an image that Blender reads", "capture the photographs again")
        values = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
        image.pixels.foreach_get(values)
        values = values.reshape(image.size[1], image.size[0], -1)
        if values.shape[-1] == 4:
            return values
        rgb = values[..., :3] if values.shape[-1] >= 3 else np.repeat(values[..., :1], 3, -1)
        return np.concatenate([rgb, np.ones_like(rgb[..., :1])], -1)
    finally:
        bpy.data.images.remove(image)


def _mask(file: Path) -> np.ndarray:
    """Read a mask (H, W) as the engine does: its alpha where there is any, else its brightness."""
    pixels = _pixels(file)
    alpha = pixels[..., 3]
    return alpha if alpha.min() < 1 else pixels[..., :3].max(-1)


def _write(mask: np.ndarray, file: Path) -> None:
    """Write a mask (H, W) uint8, bottom row first, as a grey PNG, atomically."""
    image = bpy.data.images.new(file.stem, mask.shape[1], mask.shape[0], alpha=False)
    try:
        rgba = np.ones((*mask.shape, 4), np.float32)
        rgba[..., :3] = mask[..., None] / np.float32(255)
        image.pixels.foreach_set(rgba.reshape(-1))
        file.parent.mkdir(exist_ok=True)
        with atomic_file(file) as partial:
            image.file_format, image.filepath_raw = "PNG", str(partial)
            image.save()
    except (OSError, RuntimeError) as error:
        raise InputError(file, f"can't be written ({error})") from error
    finally:
        bpy.data.images.remove(image)
