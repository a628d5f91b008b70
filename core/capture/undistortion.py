# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistorted images of a capture, at full size on disk and reduced in memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ..datasets.parsed_dataset import Lens
from ..datasets.undistort import pinhole, undistort, undistort_mask
from ..errors import InputError
from ..io.atomic import write_atomic
from ..io.image import DecodedImage, read_image, read_mask, reduce_image, reduce_mask, to_unit_range
from ..machine.thread_pool import run_reported
from ..progress.protocol import Progress
from ..scene.camera import Camera
from ..scene.dataset import View
from .sparse_model import PosedPhotograph, SparseModel

JPEG_QUALITY = 95
THREADS = 2  # a photograph of 12 megapixels takes 0.4 GB while it is undistorted


@dataclass(frozen=True, eq=False)
class UndistortedImage:
    """Undistorted image of a photograph.

    Attributes:
        posed: the photograph with its camera.
        image: file of the undistorted image, of full size.
        camera: pinhole camera of the full-size image, in the model's frame.
        view: the reduced image with its camera, in the model's frame; `view.alpha` is None.
        mask: (H, W) float32 mask that the user gave, of the view's size; None where there is none.
    """

    posed: PosedPhotograph
    image: Path
    camera: Camera
    view: View
    mask: np.ndarray | None


def undistort_photographs(model: SparseModel, folder: Path, resolution: int, progress: Progress) -> list[UndistortedImage]:
    """Write the undistorted images of all registered photographs to `folder/images`, and return them reduced.

    Args:
        model: registered photographs.
        folder: folder of the capture.
        resolution: longest side of a reduced image, pixels.
        progress: reports the images, and cancels.

    Raises:
        InputError: if a photograph can't be read, or the folder can't be written.
        Cancelled: if the user stopped the work.
    """
    target = folder / "images"
    target.mkdir(exist_ok=True)
    progress.phase("undistort photographs", len(model.posed))
    work = lambda posed: _undistorted(posed, target, resolution)  # noqa: E731
    return run_reported(work, model.posed, THREADS, progress, "stopped while photographs were undistorted")


def undistorted_pixels(pixels: np.ndarray, lens: Lens) -> np.ndarray:
    """Return the places (N, 2) in the undistorted image of places (N, 2) in the image of a lens; pixel centres are at .5."""
    plain = pinhole(lens)
    matrix = lambda k: np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1]], np.float64)  # noqa: E731
    places = np.ascontiguousarray(pixels, np.float64).reshape(-1, 1, 2)
    if not len(places) or not lens.distorted:
        return places.reshape(-1, 2)
    coefficients = np.array(lens.distortion, np.float64)
    convert = cv2.fisheye.undistortPoints if lens.fisheye else cv2.undistortPoints
    return convert(places, matrix(lens), coefficients, P=matrix(plain)).reshape(-1, 2)


def distorted_pixels(pixels: np.ndarray, lens: Lens) -> np.ndarray:
    """Return the places (N, 2) in the image of a lens of places (N, 2) in the undistorted image; pixel centres are at .5."""
    plain = pinhole(lens)
    if not len(pixels) or not lens.distorted:
        return np.asarray(pixels, np.float64).reshape(-1, 2)
    rays = (np.asarray(pixels, np.float64) - [plain.cx, plain.cy]) / [plain.fx, plain.fy]
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]], np.float64)
    project = cv2.fisheye.projectPoints if lens.fisheye else cv2.projectPoints
    rays = np.concatenate([rays, np.ones((len(rays), 1))], 1)[:, None]
    return project(rays, np.zeros(3), np.zeros(3), matrix, np.array(lens.distortion, np.float64))[0].reshape(-1, 2)


def _undistorted(posed: PosedPhotograph, folder: Path, resolution: int) -> UndistortedImage:
    photograph, lens = posed.photograph, posed.lens
    decoded = read_image(photograph.image)
    if decoded.size != lens.size:
        raise InputError(photograph.image, f"is {decoded.size[0]}x{decoded.size[1]} but its camera {lens.width}x{lens.height}")
    full = undistort(DecodedImage(to_unit_range(decoded.colour), None), lens).colour
    image = folder / f"{photograph.name}{photograph.image.suffix.lower()}"
    _save(image, full, decoded.colour.dtype)
    plain = pinhole(lens)
    camera = Camera(plain.width, plain.height, plain.fx, plain.fy, plain.cx, plain.cy, posed.to_world)
    scale = min(1.0, resolution / max(lens.size))
    small = camera.resized(max(1, round(lens.width * scale)), max(1, round(lens.height * scale)))
    colour = reduce_image(DecodedImage(full, None), small.width, small.height).colour
    view = View(photograph.name, small, image, colour, None)
    return UndistortedImage(posed, image, camera, view, _given_mask(posed, small))


def _given_mask(posed: PosedPhotograph, camera: Camera) -> np.ndarray | None:
    if posed.photograph.mask is None:
        return None
    return reduce_mask(undistort_mask(read_mask(posed.photograph.mask), posed.lens), camera.width, camera.height)


def _save(path: Path, colour: np.ndarray, dtype: np.dtype) -> None:
    """Write sRGB-encoded colours (H, W, 3) in 0..1 as a JPEG, or as a PNG of the given integer type."""
    most = np.iinfo(dtype).max
    pixels = cv2.cvtColor(np.round(np.clip(colour, 0, 1) * most).astype(dtype), cv2.COLOR_RGB2BGR)
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    done, data = cv2.imencode(path.suffix, pixels, options if path.suffix in (".jpg", ".jpeg") else [])
    if not done:
        raise InputError(path, "can't be encoded as an image")
    try:
        write_atomic(path, data.tobytes())
    except OSError as error:
        raise InputError(path, f"can't be written ({error.strerror})") from error
