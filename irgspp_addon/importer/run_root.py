# SPDX-License-Identifier: GPL-3.0-or-later
"""Collection and empty of an imported run or dataset: found in a scene, made, and placed in Blender's world."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

from .ownership import Owner, folder_of, link, put
from .placement import Placement, place, place_over

RUN, DATASET = "irgspp_run", "irgspp_dataset"  # custom properties of the empty: the imported folders


def placed_root(
    owner: Owner, scene: bpy.types.Scene, to_world: np.ndarray, centre: Sequence[float], placement: Placement | None = None
) -> tuple[bpy.types.Collection, bpy.types.Object]:
    """Return the collection and the empty of a run, created and placed if needed.

    Args:
        owner: owner of the run's datablocks.
        scene: scene that shows the collection.
        to_world: (4, 4) matrix from the dataset's own frame to the run's.
        centre: (3,) centre of the object in the run's frame.
        placement: placement in Blender's world; None places the run over its imported dataset, or else in the engine's upright frame.
    """
    collection = owner.reuse(bpy.data.collections, "collection", owner.folder.name)
    link_to_scene(collection, scene)
    root = new_root(owner, f"{collection.name} frame", collection)
    root[RUN] = str(owner.folder)
    dataset = _dataset_root(owner.folder, scene)
    if placement is None and dataset is not None:
        place_over(root, dataset, to_world)
    else:
        place(root, placement or Placement(), to_world, centre)
    return collection, root


def link_to_scene(collection: bpy.types.Collection, scene: bpy.types.Scene) -> None:
    """Link a collection into a scene, unless it is anywhere in the scene already.

    Args:
        collection: collection to link.
        scene: scene that receives it.
    """
    if collection not in scene.collection.children_recursive:
        link(collection, scene.collection)


def new_root(owner: Owner, name: str, collection: bpy.types.Collection) -> bpy.types.Object:
    """Return the empty above all imported objects, created if needed.

    Args:
        owner: owner of the datablocks.
        name: name of a new empty.
        collection: collection of the empty.
    """
    root = owner.object("root", name, None, None)
    put(root, collection)
    return root


def find_roots(scene: bpy.types.Scene, folder_property: str) -> list[bpy.types.Object]:
    """Return the empties of all imported runs or datasets in a scene.

    Args:
        scene: scene to search.
        folder_property: RUN or DATASET.
    """
    return [thing for thing in scene.objects if folder_property in thing and thing.type == "EMPTY"]


def run_of(thing: bpy.types.Object | None) -> Path | None:
    """Return the run folder from which an object was imported, or None."""
    folder, ancestor = folder_of(thing), thing
    while ancestor is not None and RUN not in ancestor:
        ancestor = ancestor.parent
    return folder if folder == folder_of(ancestor) else None


def recovered_light(run: Path | None) -> bpy.types.World | None:
    """Return the World of a run's recovered light; None where the run is not imported."""
    return None if run is None else Owner(run).find(bpy.data.worlds, "world")


def _dataset_root(run: Path, scene: bpy.types.Scene) -> bpy.types.Object | None:
    """Return the empty of the run's dataset if that has been imported too, else None."""
    try:
        dataset = json.loads((run / "run.json").read_text(encoding="utf-8"))["dataset"]
    except (OSError, ValueError, KeyError, TypeError):
        return None  # the run folder may have been passed on without run.json
    roots = find_roots(scene, DATASET)
    return next((root for root in roots if Path(root[DATASET]) == Path(dataset).resolve()), None)
