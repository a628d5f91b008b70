# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of a dataset as Blender datablocks: cameras with photographs, points, and the object's sphere, in a collection under one empty.

The engine reads the dataset, since it knows lens models and file formats, and exports plain files from which Blender builds the scene.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.errors import InputError
from ...core.scene.camera_files import load_run_cameras
from ..user_folder import user_folder
from .cameras import place_cameras
from .object_sphere import build_sphere
from .ownership import Owner
from .placement import Placement, place
from .point_cloud import build_points
from .run_root import DATASET, link_to_scene, new_root

DESCRIPTION = "dataset.json"


@dataclass(frozen=True)
class ImportedDataset:
    """Result of `build_dataset`: all objects are children of the empty `root`, in the engine's frame.

    Attributes:
        collection: collection of all objects.
        root: empty above them.
        cameras: camera objects.
        points: object of the point cloud, or None.
        sphere: empty that shows the object's bound.
        facts: the engine's description of the dataset.
    """

    collection: bpy.types.Collection
    root: bpy.types.Object
    cameras: list[bpy.types.Object]
    points: bpy.types.Object | None
    sphere: bpy.types.Object
    facts: dict[str, Any]


def checked(path: str) -> Path:
    """Return the absolute path of a dataset that the user chose.

    Raises:
        InputError: if none is chosen or it does not exist.
    """
    if not path:
        raise InputError("dataset", "none is chosen", "choose the folder of photographs")
    dataset = Path(bpy.path.abspath(path))
    if not dataset.exists():
        raise InputError(dataset, "no such file or folder", "it may have been moved; choose it again")
    return dataset.resolve()


def export_folder(dataset: Path) -> Path:
    """Return the folder for the engine's export of a dataset, in the extension's own folder, since a dataset may not be writable."""
    digest = hashlib.sha1(str(dataset.resolve()).encode(), usedforsecurity=False).hexdigest()[:12]
    folder = user_folder("datasets") / f"{dataset.stem or 'dataset'}-{digest}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def export_arguments(dataset: Path, folder: Path) -> list[str]:
    """Return the arguments of `irgspp` that export a dataset.

    Args:
        dataset: the dataset.
        folder: folder for the export.
    """
    return ["inspect", str(dataset), "--json", "--export", str(folder)]


def is_fresh(dataset: Path, folder: Path) -> bool:
    """Return True if the export is newer than all files of the dataset and next to it.

    Args:
        dataset: the dataset.
        folder: folder of its export.
    """
    try:
        exported = (folder / DESCRIPTION).stat().st_mtime
        sources = [dataset, *dataset.glob("*"), *dataset.glob("sparse/**/*")] if dataset.is_dir() else [dataset, dataset.parent]
        return all(path.stat().st_mtime < exported for path in sources)
    except OSError:
        return False


def build_dataset(
    dataset: Path,
    folder: Path,
    placement: Placement,
    photographs: bool = True,
    points: bool = True,
    scene: bpy.types.Scene | None = None,
) -> ImportedDataset:
    """Build a dataset's datablocks in a scene, in place of those of an earlier import.

    Args:
        dataset: the dataset.
        folder: folder of its export.
        placement: placement in Blender's world.
        photographs: True to show the photographs behind the cameras.
        points: True to build the point cloud.
        scene: scene to build in; None for the current one.

    Raises:
        InputError: if the export is missing or damaged; then no datablock has been created.
    """
    facts, records, cloud = _facts(folder), load_run_cameras(folder / "cameras.json"), _points(folder) if points else None
    owner = Owner(dataset)
    name = dataset.stem or dataset.resolve().name
    collection = owner.reuse(bpy.data.collections, "collection", name)
    link_to_scene(collection, scene or bpy.context.scene)
    root = new_root(owner, f"{collection.name} frame", collection)
    root[DATASET] = str(owner.folder)
    place(root, placement, np.array(facts["to_world"]), facts["centre"])
    placed = place_cameras(owner, records, root, collection, photographs)
    shown = None if cloud is None else build_points(owner, f"{collection.name} points", *cloud, facts["radius"], root, collection)
    sphere = build_sphere(owner, f"{collection.name} object", facts["centre"], facts["radius"], root, collection)
    owner.remove_unused()
    return ImportedDataset(collection, root, placed, shown, sphere, facts)


def _facts(folder: Path) -> dict[str, Any]:
    path = folder / DESCRIPTION
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        if np.array(facts["to_world"], float).shape != (4, 4) or np.array([*facts["centre"], facts["radius"]], float).shape != (4,):
            raise ValueError("to_world, centre or radius has the wrong shape")
        return facts
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})", "read the dataset again") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(path, f"does not describe a dataset ({error!r})", "read the dataset again") from error


def _points(folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Return positions (P, 3) float32 and sRGB colours (P, 3) float32, 0..1; None if the dataset has no points."""
    path = folder / "points.npz"
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as data:
            return data["position"].astype(np.float32), data["colour"].astype(np.float32) / 255
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(path, f"can't be read ({error})", "read the dataset again") from error
