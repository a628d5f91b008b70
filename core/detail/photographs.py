# SPDX-License-Identifier: GPL-3.0-or-later
"""Full-size photographs of a run: found again on the disk, and decoded one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from ..datasets.load import full_size_frames, view_of
from ..datasets.parsed_dataset import Lens
from ..datasets.prepared_frames import PreparedFrame
from ..errors import InputError
from ..io.image import read_image, to_unit_range
from ..io.srgb import decode_srgb
from ..scene.camera import Camera
from ..settings.schema import DataSettings

LEVELS = 3  # of the pyramid of a photograph, each half the size of the one before
SAME_PLACE = 1e-4  # difference of two poses' entries, as a fraction of the camera's distance from the origin, that rounding explains


@dataclass(frozen=True, eq=False)
class DecodedPhotograph:
    """Photograph in memory.

    Attributes:
        lens: lens of the file, with its distortion.
        levels: (H, W, 3) uint8 or uint16 in the file's own pixels, sRGB-encoded, and the same at a half and a quarter of the size.
        linear: (256,) or (65536,) float32 linear value of each code.
        camera: pinhole camera of the working resolution.
        reduced: (h, w, 3) float32 linear, undistorted, at the working resolution.
        alpha: (h, w) float32 mask at the working resolution, or None.
    """

    lens: Lens
    levels: tuple[np.ndarray, ...]
    linear: np.ndarray
    camera: Camera
    reduced: np.ndarray
    alpha: np.ndarray | None


@dataclass(frozen=True, eq=False)
class Photograph:
    """Photograph on the disk.

    Attributes:
        name: of its view.
        lens: lens of the file at its full size.
        working: the frame at the working resolution.
        masks: use alpha channels and mask files.
    """

    name: str
    lens: Lens
    working: PreparedFrame
    masks: bool

    def decode(self) -> DecodedPhotograph:
        """Read the file.

        Raises:
            InputError: if it is gone, damaged or of another size than before.
        """
        path = self.working.frame.image
        if path is None:
            raise InputError(self.name, "has no image")
        image = read_image(path)
        if image.size != self.lens.size:
            raise InputError(path, f"is {image.size[0]}x{image.size[1]} but was {self.lens.width}x{self.lens.height}")
        view = view_of(self.working, image, self.masks)
        codes, linear = _codes(image.colour)
        return DecodedPhotograph(self.lens, _pyramid(codes, linear), linear, view.camera, decode_srgb(view.colour), view.alpha)


def find_photographs(dataset: Path, settings: DataSettings, cameras: dict[str, Camera]) -> tuple[list[Photograph], str]:
    """Find the full-size photographs of a run's training views.

    Args:
        dataset: that the run was made from.
        settings: that it was read with.
        cameras: training cameras of the run by name.

    Returns:
        The photographs in the order of the dataset, and a line about those that are missing; the line is empty where none is.
    """
    try:
        pairs = zip(full_size_frames(dataset, settings), full_size_frames(dataset, settings, settings.resolution), strict=True)
        found = [Photograph(full.name, full.lens, working, settings.masks) for full, working in pairs]
    except InputError as error:
        return [], str(error)
    known = [one for one in found if one.name in cameras and _same_camera(one.working.camera, cameras[one.name])]
    missing = len(cameras) - len(known)
    if not missing:
        return known, ""
    return known, f"{dataset}: {missing} of {len(cameras)} photographs of the run are gone or have other cameras since"


def _same_camera(a: Camera, b: Camera) -> bool:
    """Return True for two cameras of equal size and pose."""
    scale = max(float(np.linalg.norm(b.centre)), 1e-9)
    same_pose = np.abs(a.to_world - b.to_world).max() <= SAME_PLACE * max(scale, 1.0)
    return (a.width, a.height) == (b.width, b.height) and bool(same_pose) and abs(a.fx - b.fx) <= 1e-3 * b.fx


def _codes(colour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return integer codes (H, W, 3) of encoded colours and the linear value (N,) of each code; floats become 16-bit codes."""
    if colour.dtype.kind == "u":
        most = int(np.iinfo(colour.dtype).max)
        return np.ascontiguousarray(colour), decode_srgb(np.arange(most + 1) / most).astype(np.float32)
    scale = max(1.0, float(colour.max()))
    codes = np.round(np.clip(colour / scale, 0, 1) * 65535).astype(np.uint16)
    return codes, decode_srgb(np.arange(65536) / 65535 * scale).astype(np.float32)


def _pyramid(codes: np.ndarray, linear: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the photograph and its reductions by area averaging in linear light, encoded with the same codes."""
    levels = [codes]
    for _ in range(LEVELS - 1):
        height, width = levels[-1].shape[:2]
        size = max(1, width // 2), max(1, height // 2)
        levels.append(_halved(levels[-1], size, linear))
    return tuple(levels)


def _halved(codes: np.ndarray, size: tuple[int, int], linear: np.ndarray) -> np.ndarray:
    """Return codes (H, W, 3) averaged in linear light to a size (width, height)."""
    small = cv2.resize(linear[codes], size, interpolation=cv2.INTER_AREA)
    middle = (linear[1:] + linear[:-1]) / 2
    return np.searchsorted(middle, small.ravel()).reshape(small.shape).astype(codes.dtype)


def working_lens(photograph: Photograph) -> Lens:
    """Return the lens of a photograph at the working resolution, without distortion."""
    return replace(photograph.working.lens, distortion=(), fisheye=False)


__all__ = ["DecodedPhotograph", "Photograph", "find_photographs", "to_unit_range"]
