# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of cameras exported by Agisoft Metashape (File > Export > Export Cameras, .xml)."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ...errors import InputError
from ...io.safe_paths import inside
from ...scene.camera import GL_TO_CV
from ...settings.schema import DataSettings
from ..parsed_dataset import Frame, Lens, ParsedDataset, find_image, find_mask
from ..poses import rigid_pose
from ..world_frame import normalise_world_frame

LARGEST = 256 << 20  # bytes
IMAGE_FOLDERS = ("images", "photos", "")


def find_cameras(folder: Path) -> Path | None:
    """Return Metashape's file of cameras in a folder, or None."""
    return next((f for f in sorted(folder.glob("*.xml")) if _is_ours(f)), None)


def read_metashape(path: Path, settings: DataSettings) -> ParsedDataset:
    """Read the cameras of a Metashape export, with the images next to the file or in `images` or `photos`.

    The world is the chunk's own frame, rotated so that the cameras' up is +Z, with the object at the origin.

    Args:
        path: the .xml, or the folder that contains it.
        settings: settings of the dataset.

    Raises:
        InputError: if the file is missing, damaged or not supported.
    """
    file = find_cameras(path) if path.is_dir() else path
    if file is None or not _is_ours(file):
        raise InputError(path, "is not a file of cameras exported by Metashape")
    chunk = _parsed(file).find("chunk")
    if chunk is None:
        raise InputError(file, "has no chunk")
    lenses = {s.get("id"): _lens(file, s) for s in chunk.iterfind("sensors/sensor")}
    cameras = [c for c in chunk.iter("camera") if c.find("transform") is not None and c.get("enabled", "true") not in ("false", "0")]
    solved = [c for c in cameras if lenses.get(c.get("sensor_id")) is not None]
    if not solved:
        raise InputError(file, "has no cameras with a pose and a calibration", "align the photographs before exporting")
    left_out = len(list(chunk.iter("camera"))) - len(solved)
    warnings = [f"{file.name}: {left_out} cameras are not aligned or not enabled; left out"] if left_out else []
    root = _image_root(file.parent, solved)
    frames = [_frame(file, c, lenses[c.get("sensor_id")], root) for c in solved]
    return normalise_world_frame(file, file.parent, "metashape", sorted(frames, key=lambda f: f.listed), None, warnings)


def _is_ours(file: Path) -> bool:
    try:
        with file.open("rb") as stream:
            head = stream.read(2000)
    except OSError:
        return False  # reported by the reader if it is the file that the user gave
    return b"<document" in head and b"<chunk" in head


def _parsed(file: Path) -> ElementTree.Element:
    try:
        if file.stat().st_size > LARGEST:
            raise InputError(file, f"has more than {LARGEST >> 20} MiB")
        data = file.read_bytes()
        if b"<!DOCTYPE" in data or b"<!ENTITY" in data:  # Metashape writes none; they can expand to huge texts and refer to other files
            raise InputError(file, "declares XML entities, which is refused")
        return ElementTree.fromstring(data)
    except OSError as error:
        raise InputError(file, f"can't be read ({error.strerror})") from error
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # the latter two for unknown encodings
        raise InputError(file, f"not valid XML ({error})") from error


def _number(where: object, parent: ElementTree.Element, name: str, default: float | None = 0.0) -> float:
    text = parent.findtext(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(where, f"<{name}> is not a number")
    return value


def _lens(file: Path, sensor: ElementTree.Element) -> Lens | None:
    """Parse the intrinsics of a sensor; None if it was not calibrated."""
    where = f"{file}, sensor {sensor.get('label', '')[:60]!r}"
    kind = sensor.get("type", "frame")
    found = sensor.findall("calibration")
    calibration = next((c for c in found if c.get("class") == "adjusted"), found[0] if found else None)
    if calibration is None:
        return None
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    if kind not in ("frame", "fisheye") or resolution is None:
        raise InputError(where, f"is a {kind[:20]} camera", "only frame and fisheye cameras are supported")
    try:
        width, height = int(resolution.get("width", "")), int(resolution.get("height", ""))
    except ValueError as error:
        raise InputError(where, "has no image size") from error
    f = _number(where, calibration, "f", None)
    k1, k2, k3, k4, p1, p2, b1, b2 = (_number(where, calibration, n) for n in ("k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2"))
    if abs(b2) * height > 0.5 * f:  # a skew of less than half a pixel at the image's edge is ignored
        raise InputError(where, "has skewed pixels (b2)", "export with b2 fixed to 0")
    fisheye = kind == "fisheye"
    if (k4 and not fisheye) or (fisheye and (p1 or p2)):
        what = "has distortion coefficients that OpenCV's models lack (k4 of a frame camera, p1 and p2 of a fisheye)"
        raise InputError(where, what, "export with them fixed to 0")
    # Metashape's P1 and P2 are OpenCV's p2 and p1.
    distortion = (k1, k2, k3, k4) if fisheye else (k1, k2, p2, p1, k3)
    cx, cy = width / 2 + _number(where, calibration, "cx"), height / 2 + _number(where, calibration, "cy")
    return Lens(f"METASHAPE {kind}", width, height, f + b1, f, cx, cy, distortion if any(distortion) else (), fisheye).checked(where)


def _image_root(folder: Path, cameras: list[ElementTree.Element]) -> Path:
    """Find the folder of the images that the cameras' labels name."""
    for name in IMAGE_FOLDERS:
        if any(_image(folder / name, c, folder) for c in cameras):
            return folder / name
    return folder / IMAGE_FOLDERS[0]


def _image(root: Path, camera: ElementTree.Element, folder: Path) -> Path | None:
    label = camera.get("label", "").replace("\\", "/")
    return find_image(inside(root / label, folder)) if label else None


def _frame(file: Path, camera: ElementTree.Element, lens: Lens | None, root: Path) -> Frame:
    label = camera.get("label", "")
    where = f"{file}, camera {label[:60]!r}"
    try:
        matrix = np.array([float(v) for v in (camera.findtext("transform") or "").split()])
    except ValueError as error:
        raise InputError(where, "has a transform that is not made of numbers") from error
    if matrix.size != 16:
        raise InputError(where, f"has a transform of {matrix.size} numbers, not 16")
    assert lens is not None
    image = _image(root, camera, file.parent)
    pose = rigid_pose(where, matrix.reshape(4, 4), "the transform") @ GL_TO_CV
    return Frame(label, image, find_mask(image, root) if image else None, lens, pose)
