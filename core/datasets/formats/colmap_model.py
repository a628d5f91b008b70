# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a COLMAP sparse model, text and binary, as plain records."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..parsed_dataset import FARTHEST

PARAMETERS = {"SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8}
MODEL_IDS = dict(enumerate(PARAMETERS))
OTHER_MODELS = {6: "FULL_OPENCV", 7: "FOV", 8: "SIMPLE_RADIAL_FISHEYE", 9: "RADIAL_FISHEYE", 10: "THIN_PRISM_FISHEYE"}
LONGEST_NAME = 4096


@dataclass(frozen=True)
class CameraRecord:
    """Camera of a model: name of its camera model, image size in pixels, parameters in COLMAP's order."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class ImageRecord:
    """Registered image: name with folders, camera id, rotation (w, x, y, z) and translation from world to camera (OpenCV's axes)."""

    name: str
    camera: int
    quaternion: tuple[float, float, float, float]
    translation: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class PointRecords:
    """Sparse points: position (P, 3) float64, colour (P, 3) uint8, track (P,) number of images that see each point."""

    position: np.ndarray
    colour: np.ndarray
    track: np.ndarray


def model_files(folder: Path) -> dict[str, Path] | None:
    """Find the files of the model in a folder, all binary or all text.

    Returns:
        Files by the keys "cameras", "images" and, if it exists, "points3D"; None if there is no model.
    """
    for suffix in (".bin", ".txt"):
        files = {n: folder / (n + suffix) for n in ("cameras", "images", "points3D")}
        if files["cameras"].is_file() and files["images"].is_file():
            return {n: f for n, f in files.items() if f.is_file()}
    return None


def read_cameras(file: Path) -> dict[int, CameraRecord]:
    """Read the cameras by id.

    Raises:
        InputError: if the file is damaged or a camera model is not supported.
    """
    cameras = dict(_binary_cameras(file) if file.suffix == ".bin" else _text_cameras(file))
    for number, camera in cameras.items():
        if not np.isfinite(camera.parameters).all():
            raise InputError(file, f"camera {number} has parameters that are not finite")
        if not (0 < camera.width < 1 << 20 and 0 < camera.height < 1 << 20):
            raise InputError(file, f"camera {number} has an image size of {camera.width}x{camera.height}")
    return cameras


def read_images(file: Path) -> list[ImageRecord]:
    """Read the registered images, sorted by name.

    Raises:
        InputError: if the file is damaged.
    """
    images = list(_binary_images(file) if file.suffix == ".bin" else _text_images(file))
    for image in images:
        # Negated comparisons: they are true for NaN.
        if not (np.abs(image.translation).max() < FARTHEST and 1e-6 < np.linalg.norm(image.quaternion) < 1e6):
            raise InputError(file, f"image {image.name[:80]!r} has a pose that is not finite or not a rotation")
    return sorted(images, key=lambda image: image.name)


def read_points(file: Path) -> PointRecords:
    """Read the sparse points.

    Raises:
        InputError: if the file is damaged or a point is not finite.
    """
    rows = list(_binary_points(file) if file.suffix == ".bin" else _text_points(file))
    position = np.array([r[0] for r in rows], np.float64).reshape(-1, 3)
    bad = np.flatnonzero(~np.isfinite(position).all(-1))
    if len(bad):
        # COLMAP never writes such a point: the file is damaged, and nothing else in it can be trusted.
        raise InputError(file, f"{len(bad)} of {len(rows)} points are at infinity or not a number (first: record {bad[0]})")
    return PointRecords(position, np.array([r[1] for r in rows], np.uint8).reshape(-1, 3), np.array([r[2] for r in rows], np.int64))


def _model_name(file: Path, camera: int, name: str) -> str:
    if name not in PARAMETERS:
        raise InputError(
            file,
            f"camera {camera} has an unknown camera model {name[:40]!r}",
            f"supported are {', '.join(PARAMETERS)}; colmap image_undistorter converts the others",
        )
    return name


class _Binary:
    """Sequential reader of a little-endian file; every read is checked against the end of the file."""

    def __init__(self, file: Path) -> None:
        try:
            self.file, self.data, self.offset, self.record = file, file.read_bytes(), 0, "header"
        except OSError as error:
            raise InputError(file, f"can't be read ({error.strerror})") from error

    def take(self, layout: str) -> tuple:
        size = struct.calcsize("<" + layout)
        if self.offset + size > len(self.data):
            self.fail()
        values = struct.unpack_from("<" + layout, self.data, self.offset)
        self.offset += size
        return values

    def records(self, kind: str, smallest: int) -> Iterator[int]:
        """Yield the indices of the announced records, after a check that the file is long enough for that many."""
        (count,) = self.take("Q")
        if count * smallest > len(self.data) - self.offset:
            raise InputError(self.file, f"truncated: {count} {kind}s announced, {len(self.data)} bytes are too few")
        for index in range(count):
            self.record = f"{kind} {index} of {count}"
            yield index

    def skip(self, count: int, size: int) -> None:
        if count * size > len(self.data) - self.offset:
            self.fail()
        self.offset += count * size

    def name(self) -> str:
        end = self.data.find(b"\0", self.offset, self.offset + LONGEST_NAME)
        if end < 0:
            self.fail()
        raw, self.offset = self.data[self.offset : end], end + 1
        return raw.decode("utf-8", "replace")

    def fail(self) -> None:
        raise InputError(self.file, f"truncated at {self.record}")


def _binary_cameras(file: Path) -> Iterator[tuple[int, CameraRecord]]:
    source = _Binary(file)
    for _ in source.records("camera", 24 + 3 * 8):
        number, model_id, width, height = source.take("IiQQ")
        model = _model_name(file, number, MODEL_IDS.get(model_id) or OTHER_MODELS.get(model_id, f"number {model_id}"))
        yield number, CameraRecord(model, width, height, source.take(f"{PARAMETERS[model]}d"))


def _binary_images(file: Path) -> Iterator[ImageRecord]:
    source = _Binary(file)
    for _ in source.records("image", 4 + 56 + 4 + 1 + 8):
        _, *pose, camera = source.take("I7dI")
        name = source.name()
        (points,) = source.take("Q")
        source.skip(points, 24)
        yield ImageRecord(name, camera, tuple(pose[:4]), tuple(pose[4:]))


def _binary_points(file: Path) -> Iterator[tuple[tuple, tuple, int]]:
    source = _Binary(file)
    for _ in source.records("point", 8 + 24 + 3 + 8 + 8):
        _, x, y, z, red, green, blue, _, track = source.take("Q3d3BdQ")
        source.skip(track, 8)
        yield (x, y, z), (red, green, blue), track


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Return (line number, line) without comments; blank lines stay, since the second line of an image without points is blank."""
    try:
        text = file.read_text("utf-8", "replace")
    except OSError as error:
        raise InputError(file, f"can't be read ({error.strerror})") from error
    return ((i, line.strip()) for i, line in enumerate(text.split("\n"), 1) if not line.lstrip().startswith("#"))


def _text_cameras(file: Path) -> Iterator[tuple[int, CameraRecord]]:
    for number, line in _lines(file):
        if not line:
            continue
        fields = line.split()
        try:
            camera, model, width, height = int(fields[0]), fields[1], int(fields[2]), int(fields[3])
            _model_name(file, camera, model)
            parameters = tuple(float(v) for v in fields[4:])
        except (ValueError, IndexError) as error:
            raise InputError(file, f"line {number} is not a camera ({error})") from error
        if len(parameters) != PARAMETERS[model]:
            raise InputError(file, f"line {number}: {model} takes {PARAMETERS[model]} parameters, {len(parameters)} are given")
        yield camera, CameraRecord(model, width, height, parameters)


def _text_images(file: Path) -> Iterator[ImageRecord]:
    lines = _lines(file)
    for number, line in lines:
        if not line:
            continue
        fields = line.split(maxsplit=9)
        try:
            pose, camera, name = [float(v) for v in fields[1:8]], int(fields[8]), fields[9]
        except (ValueError, IndexError) as error:
            raise InputError(file, f"line {number} is not an image ({error})") from error
        if next(lines, None) is None:
            raise InputError(file, f"truncated after line {number}: the line of 2D points is missing")
        yield ImageRecord(name, camera, (pose[0], pose[1], pose[2], pose[3]), (pose[4], pose[5], pose[6]))


def _text_points(file: Path) -> Iterator[tuple[tuple, tuple, int]]:
    for number, line in _lines(file):
        if not line:
            continue
        fields = line.split()
        try:
            position = tuple(float(v) for v in fields[1:4])
            colour = tuple(int(v) for v in fields[4:7])
            if len(colour) != 3 or not all(0 <= c <= 255 for c in colour):
                raise ValueError("colour")
            float(fields[7])
        except (ValueError, IndexError) as error:
            raise InputError(file, f"line {number} is not a point ({error})") from error
        yield position, colour, (len(fields) - 8) // 2
