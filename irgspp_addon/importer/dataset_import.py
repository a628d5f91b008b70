# SPDX-License-Identifier: GPL-3.0-or-later
"""A dataset as Blender datablocks: cameras with photographs and the point cloud, in one collection under one empty.

The engine reads the dataset (it knows lenses and file formats) and leaves plain files; Blender builds from these.
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
from .ownership import Owner
from .placement import Placement, place
from .point_cloud import build_points
from .scene_builder import DATASET, link_to_scene, new_root

DESCRIPTION = "dataset.json"


@dataclass(frozen=True)
class ImportedDataset:
    """What `build_dataset` made: everything lies below the empty `root`, in the frame that the engine works in."""

    collection: bpy.types.Collection
    root: bpy.types.Object
    cameras: list[bpy.types.Object]
    points: bpy.types.Object | None
    facts: dict[str, Any]


def checked(path: str) -> Path:
    """The absolute path of a dataset that a person named. Raises InputError where nothing is there."""
    if not path:
        raise InputError("dataset", "none is chosen", "choose the folder of photographs")
    dataset = Path(bpy.path.abspath(path))
    if not dataset.exists():
        raise InputError(dataset, "no such file or folder", "it may have been moved; choose it again")
    return dataset.resolve()


def export_folder(dataset: Path) -> Path:
    """Where the engine's files of a dataset are kept: in the extension's own folder, since a dataset may not be writable."""
    digest = hashlib.sha1(str(dataset.resolve()).encode(), usedforsecurity=False).hexdigest()[:12]
    folder = user_folder("datasets") / f"{dataset.stem or 'dataset'}-{digest}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def export_arguments(dataset: Path, folder: Path) -> list[str]:
    """The engine's command that fills the folder."""
    return ["inspect", str(dataset), "--json", "--export", str(folder)]


def is_fresh(dataset: Path, folder: Path) -> bool:
    """True where the folder holds what the dataset is now: nothing that describes it or lies beside it is younger."""
    try:
        made = (folder / DESCRIPTION).stat().st_mtime
        beside = [dataset, *dataset.glob("*"), *dataset.glob("sparse/**/*")] if dataset.is_dir() else [dataset, dataset.parent]
        return all(path.stat().st_mtime < made for path in beside)
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
    """Build what the engine left in `folder`, in place of what an earlier import of the dataset made, in a scene (default: the current).

    Raises InputError where the folder does not hold it, before anything is made.
    """
    facts, records, cloud = _facts(folder), load_run_cameras(folder / "cameras.json"), _points(folder) if points else None
    owner = Owner(dataset)
    name = dataset.stem or dataset.resolve().name
    collection = owner.kept(bpy.data.collections, "collection", name)
    link_to_scene(collection, scene or bpy.context.scene)
    root = new_root(owner, f"{collection.name} frame", collection)
    root[DATASET] = str(owner.folder)
    place(root, placement, np.array(facts["to_world"]), facts["centre"])
    placed = place_cameras(owner, records, root, collection, photographs)
    shown = None if cloud is None else build_points(owner, f"{collection.name} points", *cloud, facts["radius"], root, collection)
    owner.drop_rest()
    return ImportedDataset(collection, root, placed, shown, facts)


def _facts(folder: Path) -> dict[str, Any]:
    path = folder / DESCRIPTION
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        if np.array(facts["to_world"], float).shape != (4, 4) or np.array([*facts["centre"], facts["radius"]], float).shape != (4,):
            raise ValueError("frame or bound of a wrong shape")
        return facts
    except OSError as error:
        raise InputError(path, f"can't be read ({error.strerror})", "read the dataset again") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(path, f"does not describe a dataset ({error!r})", "read the dataset again") from error


def _points(folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions (P, 3) float32 and colours (P, 3) float32 sRGB 0..1, or None where the dataset has none."""
    path = folder / "points.npz"
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as data:
            return data["position"].astype(np.float32), data["colour"].astype(np.float32) / 255
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(path, f"can't be read ({error})", "read the dataset again") from error
