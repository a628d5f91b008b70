# SPDX-License-Identifier: GPL-3.0-or-later
"""Selected pairs: all of few photographs, else neighbours and photographs with similar descriptors."""

import numpy as np
import pycolmap
import pytest
from irgspp.core.capture.feature_database import open_database
from irgspp.core.capture.image_retrieval import similarity
from irgspp.core.capture.matching import every_pair, select_pairs
from irgspp.core.capture.photograph import Photograph

COUNT, GROUPS = 40, 4


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    """Photographs i, i + 4, i + 8, ... share descriptors, up to noise."""
    folder = tmp_path_factory.mktemp("matching")
    photographs = [Photograph(f"{i}", folder / "x", folder / f"{i}.jpg", 64, 48, "lens") for i in range(COUNT)]
    path, generator = folder / "database.db", np.random.default_rng(3)
    open_database(path, photographs)
    scenes = generator.integers(0, 200, (GROUPS, 60, 128))
    with pycolmap.Database.open(path) as opened:
        for i in range(COUNT):
            noisy = np.clip(scenes[i % GROUPS] + generator.integers(-10, 10, (60, 128)), 0, 255).astype(np.uint8)
            opened.write_keypoints(i + 1, generator.uniform(1, 40, (60, 4)).astype(np.float32))
            opened.write_descriptors(i + 1, pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, noisy))
    return path


def test_similar_descriptors_are_similar(database):
    alike = similarity(database, COUNT, 0)
    same = (np.arange(COUNT)[:, None] - np.arange(COUNT)) % GROUPS == 0
    assert alike[same].min() > 0.7 > 0.4 > alike[~same].max()
    assert np.array_equal(alike, similarity(database, COUNT, 0))


def test_few_photographs_are_matched_in_all_pairs(database):
    assert select_pairs(database, 20, "auto", 0) == every_pair(20) and len(every_pair(20)) == 190
    assert select_pairs(database, COUNT, "exhaustive", 0) == every_pair(COUNT)


@pytest.mark.parametrize("matching", ["auto", "sequential"])
def test_more_are_matched_with_neighbours_and_similar_ones(database, matching):
    pairs = set(select_pairs(database, COUNT, matching, 0))
    assert len(pairs) < len(every_pair(COUNT)) and all(i < j for i, j in pairs)
    assert {(i, i + 1) for i in range(COUNT - 1)} <= pairs
    if matching == "auto":  # nine others share the descriptors, and twenty are matched
        assert {(i, j) for i, j in every_pair(COUNT) if (j - i) % GROUPS == 0} <= pairs
    else:
        assert {(i, i + 32) for i in range(COUNT - 32)} <= pairs
