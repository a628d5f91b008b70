# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of a dataset's format by its files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import InputError
from ..settings.schema import DataSettings
from .formats import captured, colmap, glossy_real, glossy_synthetic, metashape, realitycapture, stanford_orb, tensoir, transforms
from .formats.colmap_model import model_files
from .parsed_dataset import ParsedDataset

LOOKED_FOR = (
    "looked for capture.json, transforms_train.json, transforms.json, sparse/0/cameras.bin and .txt, train_000/metadata.json, "
    "0-camera.pkl, object_point_cloud.ply, and the cameras' .xml of Metashape or .csv of RealityCapture"
)


class NoDataset(InputError):
    """No known dataset format was found in a folder."""


Recognise = Callable[[Path], object]
Read = Callable[[Path, DataSettings], ParsedDataset]

# Formats with files that no other format has come first; those recognised by a single file of cameras come last.
SPECIFIC_FORMATS: tuple[tuple[Recognise, Read], ...] = (
    (captured.find_capture, captured.read_captured),
    (tensoir.find_views, tensoir.read_tensoir),
    (glossy_synthetic.find_camera_files, glossy_synthetic.read_glossy_synthetic),
    (glossy_real.find_object_points, glossy_real.read_glossy_real),
)
GENERIC_FORMATS: tuple[tuple[Recognise, Read], ...] = (
    (metashape.find_cameras, metashape.read_metashape),
    (realitycapture.find_cameras, realitycapture.read_realitycapture),
)
COLLECTION_FORMATS: dict[str, Callable[[ParsedDataset], ParsedDataset]] = {
    "stanford-orb": stanford_orb.add_novel_views,
    "glossy-synthetic": glossy_synthetic.to_z_up,
}


def parse_dataset(path: Path, settings: DataSettings) -> ParsedDataset:
    """Read the description of a dataset, without its images.

    If a folder has several descriptions, the order of precedence is: transforms_train.json, which has its own test split; a COLMAP model
    with points; transforms.json; a COLMAP model without points. The path of one of them selects it.

    Args:
        path: a folder, a file of cameras, or the folder of a COLMAP model.
        settings: settings of the dataset.

    Raises:
        InputError: if a file is missing or damaged.
        NoDataset: if the folder holds no known dataset.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(path, "no such file or folder")
    if path.is_file():
        return _read_file(path, settings)
    for recognise, read in SPECIFIC_FORMATS:
        if recognise(path):
            return read(path, settings)
    file, model = find_transforms(path), colmap.find_model(path)
    if file is not None:
        return _read_transforms(file, settings)
    if model is not None:
        return colmap.read_colmap(model, settings)
    for recognise, read in GENERIC_FORMATS:
        if recognise(path):
            return read(path, settings)
    raise NoDataset(path, "no dataset here", LOOKED_FOR)


def find_transforms(folder: Path) -> Path | None:
    """Return the transforms file that a folder is read from, or None."""
    train, single, model = folder / "transforms_train.json", folder / "transforms.json", colmap.find_model(folder)
    if train.is_file():
        return train
    complete = model is not None and "points3D" in (model_files(model) or {})
    return single if single.is_file() and not complete else None


def _read_transforms(file: Path, settings: DataSettings) -> ParsedDataset:
    """Read a transforms file, and apply the conventions of the collection that it belongs to."""
    parsed = transforms.read_transforms(file, settings)
    return COLLECTION_FORMATS.get(parsed.format, lambda same: same)(parsed)


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
