# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a capture: photographs and videos below a folder, or a single video."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ..datasets.parsed_dataset import natural_key
from ..errors import InputError
from ..io.safe_paths import inside, is_file

PHOTOGRAPHS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".heic", ".heif")
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf")
VIDEOS = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm")
MASK_FOLDERS = ("masks", "mask")  # and masks_NAME
RECORD = "photographs.json"  # of a capture that was read; its folders are no photographs
COPIES, GIVEN_MASKS = "photographs", "given_masks"  # folders beside that file
MAX_LOOKED_AT = 2000  # entries of a folder that `has_photographs` looks at before it gives up
FIX = f"give a folder with photographs ({', '.join(s[1:] for s in (*PHOTOGRAPHS, *RAW))}) or a video ({', '.join(s[1:] for s in VIDEOS)})"


@dataclass(frozen=True)
class CaptureFiles:
    """Files of a capture, in natural order.

    Attributes:
        root: the folder that contains them all; that of the video where a single video was given.
        photographs: photographs; one of each pair of RAW and developed file.
        videos: videos without those of live photographs.
        notes: lines for the user on files that are not used.
    """

    root: Path
    photographs: list[Path]
    videos: list[Path]
    notes: list[str] = field(default_factory=list)


def is_mask_folder(name: str) -> bool:
    """Return True for the name of a folder that holds masks."""
    return name.lower() in MASK_FOLDERS or name.lower().startswith("masks_")


def has_photographs(path: Path) -> bool:
    """Return True for a video, and for a folder with a photograph or a video among the first entries; opens no file.

    Args:
        path: any path.
    """
    if is_file(path):
        return path.suffix.lower() in VIDEOS
    suffixes = (*PHOTOGRAPHS, *RAW, *VIDEOS)
    for number, file in enumerate(_walk(path)):
        if file.suffix.lower() in suffixes:
            return True
        if number > MAX_LOOKED_AT:
            break
    return False


def find_photographs(path: Path) -> CaptureFiles:
    """Find the photographs and videos of a capture; hidden files, masks and files of other kinds are skipped.

    A RAW file next to a developed file of the same name is not used: the developed file has the camera's corrections of lens and noise,
    and is what masks and other tools refer to. A video next to a photograph of the same name is the moving part of a live photograph.

    Args:
        path: folder, searched with its sub-folders, or a video.

    Raises:
        InputError: if there is nothing to read, or a link leads out of the folder.
    """
    if is_file(path):
        if path.suffix.lower() not in VIDEOS:
            raise InputError(path, "is a single file but not a video", FIX)
        return CaptureFiles(path.parent, [], [path])
    if not path.is_dir():
        raise InputError(path, "does not exist", FIX)
    found = sorted(_walk(path), key=lambda f: natural_key(f.relative_to(path).as_posix()))
    found = [inside(f, path) for f in found if f.suffix.lower() in (*PHOTOGRAPHS, *RAW, *VIDEOS)]
    developed = [f for f in found if f.suffix.lower() in PHOTOGRAPHS]
    masks = mask_neighbours(developed)
    developed = [f for f in developed if f not in masks]
    notes: list[str] = []
    raw = _without_twins([f for f in found if f.suffix.lower() in RAW], developed, "RAW files next to developed photographs", notes)
    both = sorted([*developed, *raw], key=lambda f: natural_key(f.relative_to(path).as_posix()))
    videos = _without_twins([f for f in found if f.suffix.lower() in VIDEOS], both, "videos of live photographs", notes)
    if not both and not videos:
        raise InputError(path, "has no photographs and no video", FIX)
    return CaptureFiles(path, both, videos, notes)


def mask_neighbours(images: list[Path]) -> set[Path]:
    """Return the images that are masks of their neighbours: NAME_mask.png next to NAME.jpg.

    Args:
        images: images of all folders.
    """
    stems = {base for f in images for base in (f, f.with_name(f.stem))}
    return {f for f in images if f.stem.lower().endswith("_mask") and f.with_name(f.stem[:-5]) in stems}


def _without_twins(files: list[Path], photographs: list[Path], what: str, notes: list[str]) -> list[Path]:
    """Return the files that have no photograph of the same name next to them, and note the others."""
    stems = {(f.parent, f.stem.lower()) for f in photographs}
    twins = [f for f in files if (f.parent, f.stem.lower()) in stems]
    if twins:
        notes.append(f"{len(twins)} {what} of the same name are not used, such as {twins[0].name}")
    return [f for f in files if f not in set(twins)]


def _walk(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder that are neither hidden, masks nor copies of a capture; links to folders are not followed."""
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(n for n in folders if not n.startswith(".") and not is_mask_folder(n))
        if RECORD in names and Path(place) == folder:
            folders[:] = [n for n in folders if n not in (COPIES, GIVEN_MASKS)]
        elif RECORD in names:
            folders.clear()
            continue
        yield from (Path(place, n) for n in sorted(names) if not n.startswith("."))
