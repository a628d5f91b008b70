# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure in an imported capture: two empties at points whose true distance the user knows."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ...core.errors import InputError
from .object_sphere import bound_in_root, find_sphere, matrix_in_root, own_frame, root_of
from .ownership import KEY, Owner, put

PARTS = ("measured end 1", "measured end 2")  # of the owner
DISPLAY_SIZE = 0.15  # of the empties, radii of the object's sphere


def place_ends(scene: bpy.types.Scene, dataset: Path) -> list[bpy.types.Object]:
    """Create both ends on either side of the object's sphere, unless they are there, and return them.

    Args:
        scene: scene with the imported capture.
        dataset: folder of the capture.

    Raises:
        InputError: if the capture is not in the scene.
    """
    sphere = find_sphere(scene, dataset.resolve())
    root = None if sphere is None else root_of(sphere)
    if sphere is None or root is None:
        raise InputError(dataset, "is not in the scene", "import its cameras first")
    centre, radius = bound_in_root(sphere)
    owner, ends = Owner(dataset), find_ends(scene, dataset)
    for part, side in zip(PARTS, (-1.0, 1.0), strict=True):
        if part not in ends:
            end = owner.object(part, f"{dataset.name} {part}", None, root)
            end.empty_display_type, end.empty_display_size = "PLAIN_AXES", DISPLAY_SIZE * radius
            end.location = centre + np.array((side * radius, 0, 0))
            put(end, sphere.users_collection[0])
            ends[part] = end
    return [ends[part] for part in PARTS]


def find_ends(scene: bpy.types.Scene, dataset: Path | None) -> dict[str, bpy.types.Object]:
    """Return the ends that are in a scene, by their part.

    Args:
        scene: scene to search.
        dataset: folder of the capture; None without one.
    """
    keys = {} if dataset is None else {f"{dataset.resolve()}#{part}": part for part in PARTS}
    return {keys[thing[KEY]]: thing for thing in scene.objects if thing.get(KEY) in keys}


def measured_points(scene: bpy.types.Scene, dataset: Path) -> np.ndarray:
    """Return the places (2, 3) of both ends in the dataset's own frame.

    Args:
        scene: scene with the imported capture.
        dataset: folder of the capture.

    Raises:
        InputError: if the ends are not in the scene.
    """
    ends = find_ends(scene, dataset)
    roots = [root_of(ends[part]) for part in PARTS if part in ends]
    if len(roots) < len(PARTS) or roots[0] is None:
        raise InputError(dataset, "has no measured points in the scene", "place them by Measure Two Points")
    own = own_frame(roots[0])
    places = np.stack([matrix_in_root(ends[part])[:3, 3] for part in PARTS])
    return places @ own[:3, :3].T + own[:3, 3]
