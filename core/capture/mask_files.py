# SPDX-License-Identifier: GPL-3.0-or-later
"""Mask files that people made for their photographs, by the namings of common tools."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from ..io.safe_paths import inside
from .photograph_files import PHOTOGRAPHS, RAW, is_mask_folder

MASKS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp")
IMAGE_FOLDERS = ("image", "photo", "input", "rgb", "frames")  # beginnings of names of folders whose masks lie in a folder beside them


def find_masks(folder: Path) -> dict[str, Path]:
    """Find the mask files of a folder of photographs.

    A mask is called NAME, NAME.jpg or NAME_mask with the suffix of an image. It lies in a folder `masks`, `mask` or `masks_...` inside the
    folder or beside it, with the same sub-folders as the photographs, or as NAME_mask next to its photograph.

    Args:
        folder: the folder of the photographs.

    Returns:
        Mask file by the photograph's path relative to the folder, without suffix and with "/".

    Raises:
        InputError: if a link leads out of the folder.
    """
    masks: dict[str, Path] = {}
    for file in _files(folder):
        for key in _keys(folder, PurePosixPath(file.relative_to(folder).as_posix())):
            masks.setdefault(key, inside(file, folder))
    for place in _beside(folder):
        for file in _files(place):
            masks.setdefault(str(_named(PurePosixPath(file.relative_to(place).as_posix()))), inside(file, place))
    return masks


def mask_key(file: Path, root: Path) -> str:
    """Return the key of a photograph in the result of `find_masks`.

    Args:
        file: the photograph.
        root: the folder of the photographs.
    """
    return file.relative_to(root).with_suffix("").as_posix()


def _files(folder: Path) -> Iterator[Path]:
    """Yield the images below a folder in order."""
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(n for n in folders if not n.startswith("."))
        yield from (Path(place, n) for n in sorted(names) if n.lower().endswith(MASKS) and not n.startswith("."))


def _beside(folder: Path) -> list[Path]:
    """Return the folders of masks beside a folder of photographs."""
    home, name = folder.resolve().parent, folder.resolve().name
    scaled = "masks" + name.removeprefix("images") if name.startswith("images") else "masks"
    return [p for n in dict.fromkeys((scaled, "masks", f"{name}_masks", f"{name}_mask")) if (p := home / n).is_dir()]


def _keys(folder: Path, file: PurePosixPath) -> list[str]:
    """Return the photographs that a file below the photographs' folder can be the mask of."""
    parts = file.parts
    at = next((i for i, part in enumerate(parts[:-1]) if is_mask_folder(part)), None)
    if at is None:
        return [str(_named(file))] if file.stem.lower().endswith("_mask") else []
    above, below = PurePosixPath(*parts[:at]), _named(PurePosixPath(*parts[at + 1 :]))
    return [str(above / below), *(str(above / name / below) for name in _image_folders(folder / above, parts[at]))]


def _image_folders(place: Path, masks: str) -> list[str]:
    """Return the names of the folders of photographs beside a folder of masks; those of another scale are none of its."""
    scale = masks.lower().removeprefix("masks").removeprefix("mask")
    names = [p.name for p in place.iterdir() if p.is_dir() and p.name.lower().startswith(IMAGE_FOLDERS)]
    return sorted(n for n in names if n.lower().endswith(scale))


def _named(file: PurePosixPath) -> PurePosixPath:
    """Return the path of a mask without suffix, the photograph's own suffix and _mask."""
    stem = _without_suffix(file.stem)
    return file.with_name(_without_suffix(stem[:-5] if stem.lower().endswith("_mask") and len(stem) > 5 else stem))


def _without_suffix(name: str) -> str:
    """Return a name without the suffix of a photograph."""
    path = PurePosixPath(name)
    return path.stem if path.suffix.lower() in (*PHOTOGRAPHS, *RAW) else name
