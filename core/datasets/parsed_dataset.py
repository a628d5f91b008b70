# SPDX-License-Identifier: GPL-3.0-or-later
"""What the files of a dataset say, before a single pixel is decoded."""

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
from ..settings.schema import DataSettings

MINIMUM_VIEWS = 3
FARTHEST = 1e9  # coordinates beyond are damage, and squares of them would drown everything else


@dataclass(frozen=True)
class Lens:
    """Intrinsics of a real camera, lens distortion included.

    Attributes:
        model: the name the file gives, for people ("SIMPLE_RADIAL", "OPENCV", ...).
        width, height: image size in pixels that the numbers belong to.
        fx, fy, cx, cy: in pixels; the centre of the first pixel is at (0.5, 0.5).
        distortion: OpenCV's order, (k1, k2, p1, p2, k3) or, where fisheye, (k1, k2, k3, k4); all 0 for a pinhole.
        fisheye: angles instead of tangents (OpenCV's equidistant model).
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
        """(width, height)."""
        return self.width, self.height

    @property
    def distorted(self) -> bool:
        """False for a plain pinhole."""
        return self.fisheye or any(self.distortion)

    def resized(self, width: int, height: int) -> Lens:
        """The same lens for an image of another size; distortion is relative and stays."""
        sx, sy = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy)

    def checked(self, where: object) -> Lens:
        """The lens itself. Raises InputError where its numbers can't belong to a camera."""
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
    """One photograph as listed.

    Attributes:
        listed: the name in the file that lists it, with folders.
        image: its file, or None where there is none on disk.
        mask: its mask file, or None.
        lens: intrinsics.
        to_world: (4, 4) float64 rigid camera to world, looking along -Z, +Y up.
        far: where the mask file is a depth map, the share of its range at and beyond which there is background; else None.
        light: the light the image was taken under, where that is not the dataset's.
    """

    listed: str
    image: Path | None
    mask: Path | None
    lens: Lens
    to_world: np.ndarray
    far: float | None = None
    light: str | None = None


@dataclass(frozen=True, eq=False)
class ParsedDataset:
    """A dataset as its files describe it, images that are listed but missing included.

    Attributes:
        source: the file or model folder that was read.
        root: the folder that every image and mask lies in.
        format: its short name, see docs/datasets.md.
        train, test: frames in the listed order; test is None where the files name no split.
        to_world: (4, 4) similarity from the dataset's frame to ours; the frames and points are already in ours.
        points: sparse points, or None.
        bound: the object's bound in our world where the files say it, or None.
        published: names (`listed`) of the test views of the dataset's own paper, where that is a split apart from `test`; or empty.
        novel: frames of the same object under other lights, each with its `light`: to compare relit images with.
        warnings: lines worth telling the user.
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
    warnings: list[str] = field(default_factory=list)

    def split(self, settings: DataSettings) -> tuple[list[Frame], list[Frame]]:
        """(train, test) as the settings say: the declared split, that of the dataset's paper, or every `holdout`-th view with an image
        held out, where enough are left to learn from. Raises InputError where the paper's split is asked for and not known."""
        every = self.train if self.test is None else sorted([*self.train, *self.test], key=lambda f: _natural(f.listed))
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


def _natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts numbers in names by their size."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def view_names(listed: list[str]) -> list[str]:
    """Unique view names: the file name without folders, extension or a final `rgba` part; folder parts are added where names collide.

    They can be names of files on every system, also where large and small letters are the same.
    """
    parts = [_name_parts(name) for name in listed]
    depth = [1] * len(parts)
    while True:
        names = [possible_name("_".join(p[-d:])) for p, d in zip(parts, depth, strict=True)]
        counts = Counter(map(_key, names))
        grow = [i for i, n in enumerate(names) if counts[_key(n)] > 1 and depth[i] < len(parts[i])]
        if not grow:
            return _numbered(names)
        for i in grow:
            depth[i] += 1


def _key(name: str) -> str:
    """The same for names that are one file on some system: those that don't tell large from small letters, or spell accents otherwise."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFD", name).casefold())


def _name_parts(listed: str) -> list[str]:
    path = PurePosixPath(listed.replace("\\", "/"))
    stem = path.stem if path.suffix.lower() in IMAGE_SUFFIXES else path.name
    parts = [p for p in (*path.parent.parts, stem) if p.strip("/") not in ("", ".", "..")]
    return (parts[:-1] if len(parts) > 1 and parts[-1] == "rgba" else parts) or ["view"]


def _numbered(names: list[str]) -> list[str]:
    """Files that differ in nothing but the extension, or are listed twice, get a number."""
    taken, unique = set(map(_key, names)), []
    seen: set[str] = set()
    for name in names:
        candidate, number = name, 2
        while _key(candidate) in seen or (candidate != name and _key(candidate) in taken):
            candidate, number = f"{name}_{number}", number + 1
        seen.add(_key(candidate))
        unique.append(candidate)
    return unique


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".exr")


def find_image(base: Path) -> Path | None:
    """The image file meant by `base`: as given, with another known extension, or with one added (lower or upper case)."""
    stem = base
    if base.suffix.lower() in IMAGE_SUFFIXES:
        if is_file(base):
            return base
        stem = base.with_suffix("")
    endings = (ending for suffix in IMAGE_SUFFIXES for ending in (suffix, suffix.upper()))
    return next((file for ending in endings if is_file(file := stem.with_name(stem.name + ending))), None)


def find_mask(image: Path, root: Path) -> Path | None:
    """The mask file of an image, or None: NAME.png or NAME.ext.png in a folder of masks, with the image's sub-folders, or NAME_mask.png.

    For images below `images_4` the folders are `masks_4`, `masks` beside it, `masks` inside it; for `train` also `train_mask`.
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
