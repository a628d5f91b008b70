# SPDX-License-Identifier: GPL-3.0-or-later
"""Full-size photographs of a run: found again on the disk, and decoded one at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from ..datasets.load import full_size_frames, view_of
from ..datasets.parsed_dataset import Lens
from ..datasets.prepared_frames import PreparedFrame
from ..datasets.undistort import source_positions
from ..errors import InputError
from ..io.image import image_size, read_image
from ..io.srgb import decode_srgb
from ..scene.camera import Camera
from ..scene.camera_files import PlacedCamera
from ..scene.dataset import View
from ..scene.mesh import Mesh
from ..settings.schema import DataSettings
from ..settings.sizes import SURFACE_RATIO
from ..surface.mesh_texels import surface_area

PYRAMID_LEVELS = 3  # of the pyramid of a photograph, each half the size of the one before
# Difference of two poses' entries, as a fraction of the camera's distance from the origin, that rounding explains.
MAX_POSE_DIFFERENCE = 1e-4


@dataclass(frozen=True, eq=False)
class LoadedPhotograph:
    """Full-size photograph in memory.

    Attributes:
        lens: lens of the file, with its distortion.
        pyramid: (H, W, 3) uint8 or uint16 in the file's own pixels, sRGB-encoded, and the same at a half and a quarter of the size.
        linear: (256,) or (65536,) float32 linear value of each code.
        camera: pinhole camera of the working resolution.
        reduced: (h, w, 3) float32 linear, undistorted, at the working resolution.
        alpha: (h, w) float32 mask at the working resolution, or None.
    """

    lens: Lens
    pyramid: tuple[np.ndarray, ...]
    linear: np.ndarray
    camera: Camera
    reduced: np.ndarray
    alpha: np.ndarray | None

    def undistorted(self, camera: Camera) -> np.ndarray:
        """Return the photograph as a pinhole camera of its pose sees it, (H, W, 3) float32 linear.

        Args:
            camera: camera with the pose of the photograph.
        """
        scale = self.lens.width / camera.width
        level = min(max(int(np.log2(max(scale, 1.0)) + 0.25), 0), len(self.pyramid) - 1)
        codes = self.pyramid[level]
        pinhole = Lens("PINHOLE", camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        reduced = self.lens.resized(codes.shape[1], codes.shape[0])
        maps = source_positions(reduced, pinhole)
        moved = np.asarray(cv2.remap(codes, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
        return self.linear[moved.astype(np.intp)]


@dataclass(frozen=True, eq=False)
class FullSizePhotograph:
    """Full-size photograph on the disk.

    Attributes:
        name: name of its view.
        lens: lens of the file at its full size.
        working: the frame at the working resolution.
        masks: use alpha channels and mask files.
        light_rotation: (3, 3) from the world to the frame of the light; None where the light stands still.
    """

    name: str
    lens: Lens
    working: PreparedFrame
    masks: bool
    light_rotation: np.ndarray | None = None

    @property
    def finer(self) -> float:
        """Size of the file over that at the working resolution."""
        return self.lens.width / self.working.lens.width

    def check(self) -> None:
        """Check by its header that the file is there and of the same size as before.

        Raises:
            InputError: if it is not.
        """
        path = self.working.frame.image
        if path is None or image_size(path) != self.lens.size:
            raise InputError(path or self.name, f"is not of {self.lens.width}x{self.lens.height} pixels as before")

    def load(self) -> LoadedPhotograph:
        """Read and decode the file.

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
        return LoadedPhotograph(self.lens, _pyramid(codes, linear), linear, view.camera, decode_srgb(view.colour), view.alpha)


def find_full_size_photographs(
    dataset: Path, settings: DataSettings, views: Mapping[str, View | PlacedCamera]
) -> tuple[list[FullSizePhotograph], str]:
    """Find the full-size photographs of a run's training views.

    Args:
        dataset: folder of the dataset that the run was made from.
        settings: settings that the dataset was read with.
        views: training views of the run by name.

    Returns:
        The photographs in the order of the dataset, and a line about those that are missing; the line is empty where none is.
    """
    try:
        pairs = zip(full_size_frames(dataset, settings), full_size_frames(dataset, settings, settings.resolution), strict=True)
        found = [FullSizePhotograph(full.name, full.lens, working, settings.masks) for full, working in pairs]
    except InputError as error:
        return [], str(error)
    same = [one for one in found if one.name in views and _same_camera(one.working.camera, views[one.name].camera)]
    known = [replace(one, light_rotation=views[one.name].light_rotation) for one in same]
    missing = len(views) - len(known)
    if not missing:
        return known, ""
    return known, f"{dataset}: {missing} of {len(views)} photographs of the run are gone or have other cameras since"


def object_pixels(mesh: Mesh, photographs: Sequence[FullSizePhotograph]) -> float:
    """Estimate the mean number of pixels of the full-size photographs that show an object, as if nothing lay outside of them.

    Args:
        mesh: mesh of the object.
        photographs: at least one.
    """
    centre = mesh.vertices.mean(0)
    scales = [one.lens.fx / max(float(np.linalg.norm(one.working.camera.centre - centre)), 1e-9) for one in photographs]
    return surface_area(mesh.vertices, mesh.faces) / SURFACE_RATIO * float(np.mean(np.square(scales)))


def _same_camera(a: Camera, b: Camera) -> bool:
    """Return True for two cameras of equal size and pose."""
    scale = max(float(np.linalg.norm(b.centre)), 1e-9)
    same_pose = np.abs(a.to_world - b.to_world).max() <= MAX_POSE_DIFFERENCE * max(scale, 1.0)
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
    images = [codes.view()]
    for _ in range(PYRAMID_LEVELS - 1):
        height, width = images[-1].shape[:2]
        size = max(1, width // 2), max(1, height // 2)
        images.append(_halved(images[-1], size, linear))
    for image in images:  # some decoders return read-only arrays, for which kernels would be compiled once more
        image.flags.writeable = False
    return tuple(images)


def _halved(codes: np.ndarray, size: tuple[int, int], linear: np.ndarray) -> np.ndarray:
    """Return codes (H, W, 3) averaged in linear light to a size (width, height)."""
    small = cv2.resize(linear[codes], size, interpolation=cv2.INTER_AREA)
    middle = (linear[1:] + linear[:-1]) / 2
    return np.searchsorted(middle, small.ravel()).reshape(small.shape).astype(codes.dtype)
