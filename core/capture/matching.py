# SPDX-License-Identifier: GPL-3.0-or-later
"""Matching of features between pairs of photographs, verified by two-view geometry."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pycolmap

from ..io.atomic import write_atomic
from ..machine.thread_pool import thread_count
from ..progress.protocol import Progress
from .colmap_library import run_call
from .feature_database import image_name
from .image_retrieval import similarity

MAX_EXHAUSTIVE = 30  # photographs up to which "auto" matches every pair at once
MAX_AFFORDABLE = 150  # photographs up to which "auto" matches every pair where the selected ones register too few
NEXT_PHOTOGRAPHS = {"auto": 2, "sequential": 10}  # next photographs in the order of their names that each one is matched with
SIMILAR_PHOTOGRAPHS = {"auto": 16, "sequential": 8}  # most similar photographs that each one is matched with; more give no better poses
CHUNK = 250  # pairs after which matches are written: what a killed job loses; fewer take longer
GUIDED_ERROR = 2.0  # pixels from the epipolar line at which a guided match counts; with 4, faint features gave wrong models
TILE = 8  # photographs; pairs of two tiles are matched together, since search indices of photographs are built once a chunk

Pairs = list[tuple[int, int]]


def every_pair(count: int) -> Pairs:
    """Return all pairs (i, j) of so many photographs, i < j."""
    return list(combinations(range(count), 2))


def select_pairs(path: Path, count: int, matching: str, seed: int) -> Pairs:
    """Select the pairs of photographs to match.

    Every pair, or where they are too many: the neighbours in order, and the most similar ones; of a sequence, also those at distances of
    powers of two.

    Args:
        path: the database with the features.
        count: number of photographs.
        matching: "auto", "exhaustive" or "sequential".
        seed: seed of the clustering behind the similarity.

    Returns:
        Pairs (i, j) of indices, i < j, sorted.
    """
    if matching == "exhaustive" or (matching == "auto" and count <= MAX_EXHAUSTIVE):
        return every_pair(count)
    steps = set(range(1, NEXT_PHOTOGRAPHS[matching] + 1))
    if matching == "sequential":
        steps |= {1 << k for k in range(count.bit_length())}
    pairs = {(i, i + step) for step in steps for i in range(count - step)}
    alike = similarity(path, count, seed)
    np.fill_diagonal(alike, -2)
    for i, row in enumerate(np.argsort(-alike, axis=1, kind="stable")[:, : min(SIMILAR_PHOTOGRAPHS[matching], count - 1)]):
        pairs |= {(min(i, j), max(i, j)) for j in row.tolist()}
    return sorted(pairs)


def match_features(path: Path, pairs: Pairs, seed: int, progress: Progress, guided: bool = False) -> None:
    """Match the pairs that the database has no matches of yet.

    Args:
        path: the database.
        pairs: pairs (i, j) of indices.
        seed: seed of RANSAC.
        progress: receiver; it may cancel.
        guided: match once more near the epipolar lines that the first matches give, where the ratio to the second-best match means less.

    Raises:
        Cancelled: if the user stopped the job; matches found so far are kept.
    """
    progress.phase("match photographs", len(pairs))
    pycolmap.set_random_seed(seed)
    tiled = sorted(pairs, key=lambda pair: (pair[0] // TILE, pair[1] // TILE, pair))
    for start in range(0, len(pairs), CHUNK):
        _match_chunk(path, tiled[start : start + CHUNK], seed, start, progress, guided)
        progress.step(min(start + CHUNK, len(pairs)))


def _match_chunk(path: Path, pairs: Pairs, seed: int, done: int, progress: Progress, guided: bool) -> None:
    """Match some pairs; COLMAP skips those that have matches."""
    listed = path.with_name("pairs.txt")
    write_atomic(listed, "".join(f"{image_name(i + 1)} {image_name(j + 1)}\n" for i, j in pairs).encode())
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu, matching.num_threads = False, thread_count()
    matching.guided_matching = guided
    verification = pycolmap.TwoViewGeometryOptions()
    if guided:
        verification.ransac.max_error = GUIDED_ERROR
    verification.ransac.random_seed = seed

    def call(token: pycolmap.CancellationToken) -> None:
        pycolmap.match_image_pairs(path, matching, pairing, verification, pycolmap.Device.cpu, token)

    run_call(call, progress, "stopped while photographs were matched", lambda: done)
