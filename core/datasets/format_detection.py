# SPDX-License-Identifier: GPL-3.0-or-later
"""What kind of dataset a path holds, told by what is in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import InputError
from ..settings.schema import DataSettings
from .formats import colmap, glossy_real, glossy_synthetic, metashape, realitycapture, stanford_orb, tensoir, transforms
from .formats.colmap_model import model_files
from .parsed_dataset import ParsedDataset

LOOKED_FOR = (
    "looked for transforms_train.json, transforms.json, sparse/0/cameras.bin and .txt, train_000/metadata.json, 0-camera.pkl, "
    "object_point_cloud.ply, and the cameras' .xml of Metashape or .csv of RealityCapture"
)


class NoDataset(InputError):
    """A folder has nothing of any dataset in it."""


Recognise = Callable[[Path], object]
Read = Callable[[Path, DataSettings], ParsedDataset]

# Those whose files nothing else has come first, those that only one file gives away come last.
BEFORE: tuple[tuple[Recognise, Read], ...] = (
    (tensoir.views_of, tensoir.read_tensoir),
    (glossy_synthetic.views_of, glossy_synthetic.read_glossy_synthetic),
    (glossy_real.object_points, glossy_real.read_glossy_real),
)
AFTER: tuple[tuple[Recognise, Read], ...] = (
    (metashape.find_cameras, metashape.read_metashape),
    (realitycapture.find_cameras, realitycapture.read_realitycapture),
)
FINISH: dict[str, Callable[[ParsedDataset], ParsedDataset]] = {
    "stanford-orb": stanford_orb.with_novel,
    "glossy-synthetic": glossy_synthetic.upright,
}


def parse_dataset(path: Path, settings: DataSettings) -> ParsedDataset:
    """Read the description of the dataset that is at `path`: a folder, a file of cameras, or the folder of a COLMAP model.

    Of a folder that has several descriptions the one with its own test split is read (transforms_train.json), then a COLMAP model with
    points, then transforms.json, then a COLMAP model; the path of one of them chooses it. Raises InputError on bad input, NoDataset where
    there is none.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(path, "no such file or folder")
    if path.is_file():
        return _read_file(path, settings)
    for recognise, read in BEFORE:
        if recognise(path):
            return read(path, settings)
    file, model = transforms_of(path), colmap.find_model(path)
    if file is not None:
        return _read_transforms(file, settings)
    if model is not None:
        return colmap.read_colmap(model, settings)
    for recognise, read in AFTER:
        if recognise(path):
            return read(path, settings)
    raise NoDataset(path, "no dataset here", LOOKED_FOR)


def transforms_of(folder: Path) -> Path | None:
    """The transforms file that a folder is read from, or None."""
    train, single, model = folder / "transforms_train.json", folder / "transforms.json", colmap.find_model(folder)
    if train.is_file():
        return train
    complete = model is not None and "points3D" in (model_files(model) or {})
    return single if single.is_file() and not complete else None


def _read_transforms(file: Path, settings: DataSettings) -> ParsedDataset:
    """A transforms file, and what the collection it belongs to has besides."""
    capture = transforms.read_transforms(file, settings)
    return FINISH.get(capture.format, lambda same: same)(capture)


def _read_file(file: Path, settings: DataSettings) -> ParsedDataset:
    readers: dict[str, Read] = {
        ".json": _read_transforms,
        ".xml": metashape.read_metashape,
        ".csv": realitycapture.read_realitycapture,
    }
    if file.suffix.lower() not in readers:
        raise InputError(
            file, "not a dataset", "give a folder, a transforms.json, the folder of a COLMAP model, or its cameras as .xml or .csv"
        )
    return readers[file.suffix.lower()](file, settings)
