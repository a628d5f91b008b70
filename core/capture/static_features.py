# SPDX-License-Identifier: GPL-3.0-or-later
"""Static features of a turntable: those that several photographs show at the same place, although the object turns.

What changes from photograph to photograph is not always the object. Its shadow moves over the table, and where it stands in most
photographs, the others show the table behind it. Features there match as well as those of the object, and say that nothing turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial import KDTree

from .photograph import Photograph

REACH = 0.0035  # of the photographs' longer side, within which two features are at the same place: 2 pixels of 640
LEAST_COSINE = 0.8  # of the angle between the descriptors of two features, from which they may be the same
# Other photographs that show a feature at its place, from which it is static. With a seventh of 30 photographs, 1.6 pixels and a cosine
# of .9, so many stayed that half of a boot's cameras were found as if it stood still. The object's own are lost where it hardly moves,
# near the axis.
LEAST_OTHERS = 2


def drop_static_features(path: Path, photographs: Sequence[Photograph]) -> None:
    """Remove the static features of a turntable from a database in which nothing is matched yet; else leave it as it is.

    Args:
        path: the database file, with the features of all photographs.
        photographs: image i + 1 of the database is photograph i; all of one size.
    """
    numbers = range(1, len(photographs) + 1)
    with pycolmap.Database.open(path) as database:
        if database.num_matched_image_pairs():
            return  # a stopped job goes on: matches refer to the features by number
        tables, found = [database.read_keypoints(i) for i in numbers], [database.read_descriptors(i) for i in numbers]
        reach = REACH * max(photographs[0].width, photographs[0].height)
        kept = [~one for one in static_features([table[:, :2] for table in tables], [one.data for one in found], reach)]
        with pycolmap.DatabaseTransaction(database):
            database.clear_keypoints()
            database.clear_descriptors()
            for number, table, one, rows in zip(numbers, tables, found, kept, strict=True):
                database.write_keypoints(number, table[rows])
                database.write_descriptors(number, pycolmap.FeatureDescriptors(one.type, one.data[rows]))


def static_features(places: Sequence[np.ndarray], descriptors: Sequence[np.ndarray], reach: float) -> list[np.ndarray]:
    """Return which features of each photograph at least LEAST_OTHERS others show at the same place.

    Args:
        places: (N, 2) of each photograph's features, in pixels.
        descriptors: (N, D) of each photograph's features.
        reach: distance up to which two features are at the same place, pixels.

    Returns:
        (N,) bool for each photograph.
    """
    shown = [np.zeros(len(one), int) for one in places]
    known = [i for i, one in enumerate(places) if len(one)]
    trees, unit = {i: KDTree(places[i]) for i in known}, {i: _normalised(descriptors[i]) for i in known}
    for position, i in enumerate(known):
        for j in known[:position]:
            near = trees[i].sparse_distance_matrix(trees[j], reach, output_type="ndarray")
            alike = (unit[i][near["i"]] * unit[j][near["j"]]).sum(1) > LEAST_COSINE
            shown[i][np.unique(near["i"][alike])] += 1
            shown[j][np.unique(near["j"][alike])] += 1
    return [one >= LEAST_OTHERS for one in shown]


def _normalised(descriptors: np.ndarray) -> np.ndarray:
    """Return descriptors (N, D) of unit length, float32."""
    vectors = descriptors.astype(np.float32)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-6)
