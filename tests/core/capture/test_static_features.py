# SPDX-License-Identifier: GPL-3.0-or-later
"""Static features: those at the same place in several photographs go, those that move stay, and a stopped job keeps its numbers."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from irgspp.core.capture.feature_database import feature_counts, open_database
from irgspp.core.capture.photograph import Photograph
from irgspp.core.capture.static_features import drop_static_features, static_features

COUNT, STATIC, TURNING = 6, 40, 25


def features(seed: int = 0) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Places and descriptors of COUNT photographs: STATIC features stay, the others move by 9 pixels a photograph; and the first ones."""
    random = np.random.default_rng(seed)
    table = random.uniform(50, 500, (STATIC + TURNING, 2))
    codes = random.integers(0, 256, (STATIC + TURNING, 128))
    moves = np.repeat([[0.0, 0.0], [9.0, 0.0]], [STATIC, TURNING], axis=0)
    places = [table + i * moves + random.normal(0, 0.3, table.shape) for i in range(COUNT)]
    noise = [np.clip(codes + random.normal(0, 8, codes.shape), 0, 255).astype(np.uint8) for _ in range(COUNT)]
    return places, noise, np.arange(STATIC + TURNING) < STATIC


def test_what_several_photographs_show_at_one_place_is_static():
    places, descriptors, static = features()
    for found in static_features(places, descriptors, 2.0):
        assert np.array_equal(found, static)


def test_one_other_photograph_is_not_enough():
    places, descriptors, _ = features()
    assert not np.any(static_features(places[:2], descriptors[:2], 2.0))


def test_other_features_at_the_same_place_do_not_count():
    places, _, _ = features()
    others = [np.random.default_rng(i).integers(0, 2, (STATIC + TURNING, 128)) * 255 for i in range(COUNT)]
    assert not np.any(static_features(places, others, 2.0))


def test_photographs_without_features_are_no_others():
    places, descriptors, static = features()
    none = np.zeros((0, 2)), np.zeros((0, 128), np.uint8)
    first, *rest = static_features([none[0], *places], [none[1], *descriptors], 2.0)
    assert first.shape == (0,)
    assert all(np.array_equal(found, static) for found in rest)


@pytest.fixture
def database(tmp_path: Path) -> tuple[Path, list[Photograph]]:
    path, photographs = tmp_path / "database.db", [Photograph(f"{i}", tmp_path, tmp_path, 640, 480, "lens") for i in range(COUNT)]
    open_database(path, photographs)
    with pycolmap.Database.open(path) as opened, pycolmap.DatabaseTransaction(opened):
        for i, (place, codes) in enumerate(zip(*features()[:2], strict=True)):
            opened.write_keypoints(i + 1, np.column_stack([place, np.ones((len(place), 2))]).astype(np.float32))
            opened.write_descriptors(i + 1, pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, codes))
    return path, photographs


def test_they_are_removed_from_the_database_once(database):
    path, photographs = database
    for _ in range(2):
        drop_static_features(path, photographs)
        assert feature_counts(path, COUNT).tolist() == [TURNING] * COUNT
    with pycolmap.Database.open(path) as opened:
        expected = features()[0][3][STATIC:]
        np.testing.assert_allclose(opened.read_keypoints(4)[:, :2], expected, atol=1e-3)


def test_features_that_are_matched_keep_their_numbers(database):
    path, photographs = database
    with pycolmap.Database.open(path) as opened, pycolmap.DatabaseTransaction(opened):
        opened.write_matches(1, 2, np.array([[0, 0], [1, 1]], np.uint32))
    drop_static_features(path, photographs)
    assert feature_counts(path, COUNT).tolist() == [STATIC + TURNING] * COUNT
