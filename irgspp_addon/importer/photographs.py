# SPDX-License-Identifier: GPL-3.0-or-later
"""Quick look at a folder for panels: does it hold photographs without cameras? The engine decides in the end.

Only names are compared, and the heads of a few description files are read: a panel must not wait for photographs to be opened.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from ..properties import VIDEOS

PHOTOGRAPHS = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".heic", ".heif")
SHOWN = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp")  # that Blender shows
OTHERS = (".exr", ".hdr", ".npy", ".npz", ".json", ".bin", ".txt", ".xml", ".csv", ".pkl", ".ply", ".db")  # in datasets of other programs
RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf")
RECORD = "photographs.json"  # in the folder of a capture, whose images are copies
DESCRIPTIONS = ("capture.json", "transforms_train.json", "transforms.json", "0-camera.pkl", "object_point_cloud.ply")
MODEL_FOLDERS = ("", "sparse/0", "sparse", "0", "colmap/sparse/0", "colmap/sparse")  # of COLMAP
HEADS = {".xml": b"<document", ".csv": b"#name"}  # texts by which cameras of Metashape and RealityCapture are recognised
HEAD_BYTES = 4096
LOOKED_AT = 2000  # files and folders after which the look ends


@dataclass(frozen=True)
class BarePhotographs:
    """Photographs and videos without cameras.

    Attributes:
        photographs: number of photographs; a RAW file and the photograph developed from it count once.
        videos: number of videos.
        complete: False if there are more files than were looked at.
    """

    photographs: int
    videos: int
    complete: bool = True


def find_bare_photographs(path: Path) -> BarePhotographs | None:
    """Return the photographs of a folder without cameras, or a video; None for datasets, for other folders, and for no folder.

    Args:
        path: folder or file that the user chose.
    """
    try:
        if path.is_file():
            return BarePhotographs(0, 1) if path.suffix.lower() in VIDEOS else None
        if not path.is_dir() or has_cameras(path):
            return None
        return _count(path)
    except OSError:  # a folder that may not be read: the engine's error says so
        return None


def problem_of(path: Path) -> str:
    """Return what a chosen path lacks, in a sentence; "" where the engine can look for more.

    Args:
        path: folder or file that the user chose.
    """
    try:
        if not path.exists():
            return "This folder is not there. It may have been moved; choose it again."
        if path.is_dir() and not has_cameras(path) and not any(_may_be_read(file) for file in islice(_walk(path), LOOKED_AT)):
            return "There are no photographs in this folder."
    except OSError:
        return "This folder can't be read."
    return ""


def _may_be_read(file: Path) -> bool:
    return file.suffix.lower() in (*PHOTOGRAPHS, *RAW, *VIDEOS, *OTHERS)


def sample_photographs(folder: Path, count: int = 4) -> tuple[Path, ...]:
    """Return a few photographs of a folder that Blender can show, evenly chosen by name; none for a file.

    Args:
        folder: folder that the user chose.
        count: number of photographs at most.
    """
    if not folder.is_dir():
        return ()
    found = sorted(file for file in islice(_walk(folder), LOOKED_AT) if file.suffix.lower() in SHOWN)
    return tuple(found[len(found) * i // count] for i in range(min(count, len(found))))


def has_cameras(folder: Path) -> bool:
    """Return True if a folder holds a file that describes cameras in one of the known formats."""
    if any((folder / name).is_file() for name in DESCRIPTIONS):
        return True
    models = [folder / name for name in MODEL_FOLDERS]
    if any((m / f"cameras{suffix}").is_file() and (m / f"images{suffix}").is_file() for m in models for suffix in (".bin", ".txt")):
        return True
    return any(_describes_cameras(entry) for entry in os.scandir(folder))


def _describes_cameras(entry: os.DirEntry[str]) -> bool:
    if entry.name.startswith("train_"):
        return Path(entry.path, "metadata.json").is_file()  # TensoIR's layout
    head = HEADS.get(Path(entry.name).suffix.lower())
    if head is None or not entry.is_file():
        return False
    with open(entry.path, "rb") as file:
        return head in file.read(HEAD_BYTES)


def _count(folder: Path) -> BarePhotographs | None:
    photographs: set[Path] = set()
    videos: set[Path] = set()
    complete = True
    for number, file in enumerate(_walk(folder)):
        if number >= LOOKED_AT:
            complete = False
            break
        suffix = file.suffix.lower()
        if suffix in PHOTOGRAPHS or suffix in RAW:
            photographs.add(file.with_suffix(""))
        elif suffix in VIDEOS:
            videos.add(file.with_suffix(""))
    videos -= photographs  # the moving part of a live photograph
    return BarePhotographs(len(photographs), len(videos), complete) if photographs or videos else None


def _walk(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder, without hidden files, masks and captures."""
    for place, folders, names in os.walk(folder):
        if RECORD in names and Path(place) != folder:
            folders.clear()
            continue
        folders[:] = [name for name in folders if not name.startswith(".") and not _holds_masks(name.lower())]
        yield from (Path(place, name) for name in names if not name.startswith("."))


def _holds_masks(folder: str) -> bool:
    return folder in ("mask", "masks") or folder.startswith("masks_")
