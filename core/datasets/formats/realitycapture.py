# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of cameras exported by RealityCapture (Registration > Internal/External camera parameters, .csv)."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...io.image import image_size
from ...io.safe_paths import inside
from ...settings.schema import DataSettings
from ..parsed_dataset import FARTHEST, Frame, Lens, ParsedDataset, find_image, find_mask
from ..world_frame import normalise_world_frame
from .metashape import IMAGE_FOLDERS

COLUMNS = ("#name", "x", "y", "alt", "heading", "pitch", "roll", "f", "px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
FILM = 36.0  # mm, longer side of 35 mm film, which the focal lengths refer to
HEAD = 5  # number of lines within which the header must be


def find_cameras(folder: Path) -> Path | None:
    """Return RealityCapture's file of cameras in a folder, or None."""
    return next((f for f in sorted(folder.glob("*.csv")) if _header(f) is not None), None)


def read_realitycapture(path: Path, settings: DataSettings) -> ParsedDataset:
    """Read the cameras of a RealityCapture export, with the images next to the file or in `images` or `photos`.

    The frame of the export has +Z up already; the object is moved to the origin.

    Args:
        path: the .csv, or the folder that contains it.
        settings: settings of the dataset.

    Raises:
        InputError: if the file is missing, damaged or not supported.
    """
    file = find_cameras(path) if path.is_dir() else path
    start = None if file is None else _header(file)
    if file is None or start is None:
        raise InputError(path, "is not a file of cameras exported by RealityCapture", f"its columns are {', '.join(COLUMNS)}")
    rows = _rows(file, start)
    images = {row["#name"]: _image(file.parent, row["#name"]) for row in rows}
    present = {name: image for name, image in images.items() if image is not None}
    if not present:
        fix = f"put them next to it or in images; first: {rows[0]['#name'][:80]!r}"
        raise InputError(file, f"none of its {len(rows)} images exists", fix)
    frames = [_frame(file, row, present[row["#name"]]) for row in rows if row["#name"] in present]
    missing = len(rows) - len(frames)
    warnings = [f"{file.name}: {missing} of {len(rows)} images are missing; left out"] if missing else []
    return normalise_world_frame(file, file.parent, "realitycapture", sorted(frames, key=lambda f: f.listed), None, warnings, upright=True)


def _header(file: Path) -> int | None:
    """Return the index of the line that names the columns, or None if there is none."""
    try:
        with file.open("r", encoding="utf-8-sig", errors="replace") as stream:
            lines = [stream.readline(2000) for _ in range(HEAD)]
    except OSError:
        return None  # reported by the reader if it is the file that the user gave
    return next((i for i, line in enumerate(lines) if {"#name", "heading", "pitch", "roll", "f"} <= set(_split(line))), None)


def _split(line: str) -> list[str]:
    return [word.strip() for word in line.replace(";", ",").split(",")]


def _rows(file: Path, start: int) -> list[dict[str, str]]:
    try:
        lines = file.read_text("utf-8-sig", "replace").splitlines()[start:]
    except OSError as error:
        raise InputError(file, f"can't be read ({error.strerror})") from error
    columns = _split(lines[0])
    missing = [c for c in COLUMNS[:8] if c not in columns]
    if missing:
        raise InputError(file, f"has no column {', '.join(missing)}", "export internal and external camera parameters")
    separator = ";" if ";" in lines[0] else ","
    try:
        rows = [dict(zip(columns, row, strict=False)) for row in csv.reader(lines[1:], delimiter=separator) if row and row[0].strip()]
    except csv.Error as error:
        raise InputError(file, f"is not a readable table ({error})") from error
    if not rows:
        raise InputError(file, "lists no cameras")
    return rows


def _image(folder: Path, name: str) -> Path | None:
    candidates = (folder / place / name.replace("\\", "/") for place in IMAGE_FOLDERS)
    return next(filter(None, (find_image(inside(c, folder)) for c in candidates)), None)


def _frame(file: Path, row: dict[str, str], image: Path) -> Frame:
    where = f"{file}, {row['#name'][:80]}"
    x, y, z, heading, pitch, roll, f, px, py, k1, k2, k3, k4, t1, t2 = (_number(where, row, c) for c in COLUMNS[1:])
    if max(map(abs, (x, y, z))) > FARTHEST:
        raise InputError(where, "puts the camera at infinity")
    if k4:
        fix = "choose the model Brown3, with or without tangential distortion"
        raise InputError(where, "has a distortion coefficient that OpenCV's model lacks (k4)", fix)
    width, height = image_size(image)
    longest = max(width, height)
    distortion = (k1, k2, t1, t2, k3)
    focal = f / FILM * longest
    lens = Lens("REALITYCAPTURE", width, height, focal, focal, width / 2 + px * longest, height / 2 + py * longest,
                distortion if any(distortion) else ()).checked(where)  # fmt: skip
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = _rotation(-heading, pitch, roll), (x, y, z)
    return Frame(row["#name"], image, find_mask(image, image.parent), lens, to_world)


def _number(where: str, row: dict[str, str], column: str) -> float:
    try:
        value = float(row.get(column) or 0.0)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(where, f"{column} is not a number")
    return value


def _rotation(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Return the rotation (3, 3) by degrees about Z, then X, then Y of the rotated frame; all 0 looks straight down, image top to +Y."""
    (sz, cz), (sx, cx), (sy, cy) = ((math.sin(a), math.cos(a)) for a in map(math.radians, (yaw, pitch, roll)))
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return about_z @ about_x @ about_y
