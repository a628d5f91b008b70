# SPDX-License-Identifier: GPL-3.0-or-later
"""Similarity of photographs by vectors of locally aggregated descriptors (VLAD; Jégou et al. 2010)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
from scipy.cluster.vq import kmeans2, vq

WORDS = 64  # clusters of the descriptors
SAMPLES = 20_000  # descriptors that are clustered
DESCRIPTORS = 1500  # taken of each photograph, those of the largest scale


def similarity(path: Path, count: int, seed: int) -> np.ndarray:
    """Return the cosine between the aggregated descriptors of each pair of photographs (N, N), -1..1; 0 where one has no features.

    Args:
        path: the database of features.
        count: number of photographs.
        seed: seed of the clustering.
    """
    descriptors = _read_descriptors(path, count)
    every = np.concatenate(descriptors)
    if len(every) < WORDS:
        return np.zeros((count, count))
    generator = np.random.default_rng(seed)
    sample = every[generator.permutation(len(every))[:SAMPLES]]
    words, _ = kmeans2(sample, WORDS, iter=15, minit="points", rng=np.random.default_rng(seed))
    vectors = np.stack([_aggregate(one, words) for one in descriptors])
    return vectors @ vectors.T


def _read_descriptors(path: Path, count: int) -> list[np.ndarray]:
    """Read the descriptors of each photograph, (D, 128) float32 unit vectors."""
    found = []
    with pycolmap.Database.open(path) as database:
        for number in range(1, count + 1):
            largest = np.argsort(-database.read_keypoints(number)[:, 2], kind="stable")[:DESCRIPTORS]
            chosen = database.read_descriptors(number).data[largest].astype(np.float32)
            found.append(chosen / np.maximum(np.linalg.norm(chosen, axis=1, keepdims=True), 1e-6))
    return found


def _aggregate(descriptors: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Sum the residuals of the descriptors (D, 128) from their words (W, 128), normalised by word and as a whole (W x 128)."""
    total = np.zeros_like(words)
    if len(descriptors):
        nearest, _ = vq(descriptors, words)
        np.add.at(total, nearest, descriptors - words[nearest])
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-9)
    return total.ravel() / max(np.linalg.norm(total), 1e-9)
