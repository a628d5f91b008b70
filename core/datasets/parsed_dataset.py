# SPDX-License-Identifier: GPL-3.0-or-later
"""Description of a dataset as parsed from its files, before any image is decoded."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

import numpy as np

from ..errors import InputError
from ..io.safe_paths import is_file, possible_name
from ..scene.dataset import Bound, PointCloud
from ..scene.surroundings import Surroundings
from ..settings.schema import DataSettings

MINIMUM_VIEWS = 3
FARTHEST = 1e9  # coordinates beyond are damage, and their squares would cancel all others


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a real camera, with its lens distortion.

    Attributes:
        model: name of the camera model in the file, for the user ("SIMPLE_RADIAL", "OPENCV", ...).
        width, height: image size in pixels that the intrinsics belong to.
        fx, fy, cx, cy: focal lengths and principal point in pixels; the centre of the first pixel is at (0.5, 0.5).
        distortion: coefficients in OpenCV's order, (k1, k2, p1, p2, k3) or, for a fisheye, (k1, k2, k3, k4); all 0 for a pinhole.
        fisheye: OpenCV's equidistant model, whose polynomial is in the angle instead of its tangent.
    """

    model: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    fisheye: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """Size as (width, height) in pixels."""
        return self.width, self.height

    @property
    def distorted(self) -> bool:
        """Flag of lens distortion: False for a plain pinhole."""
        return self.fisheye or any(self.distortion)

    def resized(self, width: int, height: int) -> Lens:
        """Return the same lens for an image of another size; the distortion is relative and does not change.

        Args:
            width: in pixels.
            height: in pixels.
        """
        sx, sy = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy)

    def checked(self, where: object) -> Lens:
        """Check that the values are possible for a camera, and return the lens.

        Args:
            where: the file, for messages.

        Raises:
            InputError: if focal length, principal point or distortion is impossible.
        """
        longest = max(self.size)
        if not (min(self.fx, self.fy) > 1e-3 * longest and max(self.fx, self.fy) < 1e5 * longest):
            raise InputError(where, f"has an impossible focal length ({self.fx:g}, {self.fy:g} for {self.width}x{self.height} pixels)")
        if not max(abs(self.cx), abs(self.cy)) < 10 * longest:
            raise InputError(where, f"has an impossible principal point ({self.cx:g}, {self.cy:g})")
        if not all(abs(k) < 1e4 for k in self.distortion):
            raise InputError(where, f"has impossible distortion coefficients {self.distortion}")
        return self

    def __str__(self) -> str:
        names = ("k1", "k2", "k3", "k4") if self.fisheye else ("k1", "k2", "p1", "p2", "k3")
        terms = [f"{n} {k:.4g}" for n, k in zip(names, self.distortion, strict=False) if k]
        focal = f"{self.fx:.1f}" if abs(self.fx - self.fy) < 0.05 else f"{self.fx:.1f}, {self.fy:.1f}"
        return f"{self.model} {self.width}x{self.height}, focal {focal} px, centre ({self.cx:.1f}, {self.cy:.1f}), " + (
            "distortion " + ", ".join(terms) if terms else "no distortion"
        )


@dataclass(frozen=True, eq=False)
class Frame:
    """Photograph as listed in the dataset's files.

    Attributes:
        listed: its name in the file that lists it, with folders.
        image: its file, or None if it is not on disk.
        mask: its mask file, or None.
        lens: intrinsics.
        to_world: (4, 4) float64 rigid camera to world, looking along -Z, +Y up.
        far: if the mask file is a depth map, the fraction of its range from which on there is background; else None.
        light: name of the light that it was taken under, if it is not the dataset's own.
        gain: linear exposure gain (3,) of its colours that the dataset states, relative to the other photographs; else None.
        light_rotation: (3, 3) float64 rotation from the world to the frame of the light that the dataset states; None: identity.
    """

    listed: str
    image: Path | None
    mask: Path | None
    lens: Lens
    to_world: np.ndarray
    far: float | None = None
    light: str | None = None
    gain: np.ndarray | None = None
    light_rotation: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class ParsedDataset:
    """Dataset as its files describe it, including images that are listed but missing.

    Attributes:
        source: the file or model folder that was read.
        root: the folder that contains every image and mask.
        format: short name of the format, see docs/datasets.md.
        train, test: frames in the listed order; test is None if the files name no split.
        to_world: (4, 4) similarity from the dataset's own frame to the world; frames and points are already in the world.
        points: sparse points in the world, or None.
        bound: bounding sphere of the object in the world if the files state it, or None.
        published: names (`listed`) of the test views of the dataset's paper, if that is another split than `test`; else empty.
        novel: frames of the same object under other lights, each with its `light`; relit images are compared with them.
        surroundings: near surfaces that shadow and light the object, in the world, or None.
        mask_error: distance by which the edges of mask files may be wrong, in longest sides of an image.
        warnings: warnings for the user, one line each.
    """

    source: Path
    root: Path
    format: str
    train: list[Frame]
    test: list[Frame] | None
    to_world: np.ndarray
    points: PointCloud | None = None
    bound: Bound | None = None
    published: frozenset[str] = frozenset()
    novel: list[Frame] = field(default_factory=list)
    surroundings: Surroundings | None = None
    mask_error: float = 0.0
    warnings: list[str] = field(default_factory=list)

    def split(self, settings: DataSettings) -> tuple[list[Frame], list[Frame]]:
        """Split the frames into training and test frames.

        Args:
            settings: `split` selects the declared split, that of the dataset's paper, or every `holdout`-th view with an image as a test
                view, if enough training views are left.

        Returns:
            Training frames and test frames.

        Raises:
            InputError: if the paper's split is requested but not known.
        """
        every = self.train if self.test is None else sorted([*self.train, *self.test], key=lambda f: natural_key(f.listed))
        if settings.split == "published":
            if not self.published:
                raise InputError("data.split", f"no published split is known for the format {self.format}", "use auto or holdout")
            return [f for f in every if f.listed not in self.published], [f for f in every if f.listed in self.published]
        if self.test is not None and settings.split == "auto":
            return self.train, self.test
        holdout = settings.holdout
        frames = [f for f in every if f.image is not None] or every
        if holdout < 2 or len(frames) - len(frames[::holdout]) < MINIMUM_VIEWS:
            return frames, []
        return [f for i, f in enumerate(frames) if i % holdout], frames[::holdout]


def natural_key(name: str) -> list[tuple[int, str]]:
    """Return a sort key that orders numbers in names by their value."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def view_names(listed: list[str]) -> list[str]:
    """Derive unique view names: file names without folders, extension or a final `rgba` part; folders are prepended where names collide.

    They are valid and distinct file names on every system, also where upper and lower case are the same.

    Args:
        listed: names of the images with folders.
    """
    parts = [_name_parts(name) for name in listed]
    depth = [1] * len(parts)
    while True:
        names = [possible_name("_".join(p[-d:])) for p, d in zip(parts, depth, strict=True)]
        counts = Counter(map(_file_name_key, names))
        grow = [i for i, n in enumerate(names) if counts[_file_name_key(n)] > 1 and depth[i] < len(parts[i])]
        if not grow:
            return _numbered(names)
        for i in grow:
            depth[i] += 1


def _file_name_key(name: str) -> str:
    """Return a key that is equal for names of the same file on some system, which ignores case or composes accents differently."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFD", name).casefold())


def _name_parts(listed: str) -> list[str]:
    path = PurePosixPath(listed.replace("\\", "/"))
    stem = path.stem if path.suffix.lower() in IMAGE_SUFFIXES else path.name
    parts = [p for p in (*path.parent.parts, stem) if p.strip("/") not in ("", ".", "..")]
    return (parts[:-1] if len(parts) > 1 and parts[-1] == "rgba" else parts) or ["view"]


def _numbered(names: list[str]) -> list[str]:
    """Append a number to the names of files that differ only in the extension or are listed twice."""
    taken, unique = set(map(_file_name_key, names)), []
    seen: set[str] = set()
    for name in names:
        candidate, number = name, 2
        while _file_name_key(candidate) in seen or (candidate != name and _file_name_key(candidate) in taken):
            candidate, number = f"{name}_{number}", number + 1
        seen.add(_file_name_key(candidate))
        unique.append(candidate)
    return unique


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr")


def find_image(base: Path) -> Path | None:
    """Find the image file of a listed path: as it is, with another known extension, or with one appended (lower or upper case).

    Returns:
        The file, or None if there is none.
    """
    stem = base
    if base.suffix.lower() in IMAGE_SUFFIXES:
        if is_file(base):
            return base
        stem = base.with_suffix("")
    endings = (ending for suffix in IMAGE_SUFFIXES for ending in (suffix, suffix.upper()))
    return next((file for ending in endings if is_file(file := stem.with_name(stem.name + ending))), None)


def find_mask(image: Path, root: Path) -> Path | None:
    """Find the mask file of an image: NAME_mask.png next to it, or NAME.png or NAME.ext.png in a folder of masks with its sub-folders.

    For images in `images_4`, the folders are `masks_4` and `masks` next to it and `masks` inside it; for `train` also `train_mask`.

    Args:
        image: the image file.
        root: the folder of images that contains it.

    Returns:
        The file, or None if there is none.
    """
    scaled = "masks" + root.name.removeprefix("images") if root.name.startswith("images") else "masks"
    folders = (root.parent / scaled, root.parent / "masks", root / "masks", root.parent / (root.name + "_mask"))
    candidates = [image.with_name(image.stem + "_mask.png")]
    for masks in dict.fromkeys(folders):
        try:
            inside = masks / image.relative_to(root)
        except ValueError:
            inside = masks / image.name
        candidates += [inside.with_suffix(".png"), inside.with_name(inside.name + ".png")]
    return next((c for c in candidates if c != image and is_file(c)), None)
