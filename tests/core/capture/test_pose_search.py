# SPDX-License-Identifier: GPL-3.0-or-later
"""What follows where few photographs fit together: which retries run, which of their models is kept, and what is said."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from irgspp.core.capture import pose_search
from irgspp.core.capture.colmap_library import silence
from irgspp.core.capture.feature_database import inlier_counts, restore_matches
from irgspp.core.capture.mapping import Freedom
from irgspp.core.capture.pose_search import PoseSearch, Solution
from irgspp.core.settings.schema import CaptureSettings
from room_corner import cameras, take, textures

PHOTOGRAPHS, FEW = 6, 3


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    silence()
    return [shot.photograph for shot in take(tmp_path_factory.mktemp("photographs"), cameras(PHOTOGRAPHS), textures())]


def searched(patch, photographs, folder, heard, enough):
    """Run the search while the mapper registers few photographs, except by databases with these names; also return progress and calls."""
    mapper, progress, calls = pose_search.map_photographs, heard(), []

    def few(path, count, attempt, seed, progress):
        calls.append((path.name, attempt.lenient))
        models = mapper(path, count, attempt, seed, progress)
        for number in [] if path.name in enough else sorted(models[0].reg_image_ids())[FEW:]:
            models[0].deregister_frame(models[0].image(number).frame_id)
        return models

    patch.setattr(pose_search, "map_photographs", few)
    return PoseSearch(photographs, folder, CaptureSettings(), 0, progress, None).run(), progress, calls


@pytest.fixture
def search(photographs, tmp_path, heard, monkeypatch):
    return lambda *enough: searched(monkeypatch, photographs, tmp_path, heard, enough)


@pytest.fixture(scope="module")
def guided(photographs, heard, tmp_path_factory):
    """A search in which guided matching is enough, and its folder."""
    folder = tmp_path_factory.mktemp("guided")
    with pytest.MonkeyPatch.context() as patch:
        return *searched(patch, photographs, folder, heard, ("database_guided.db",)), folder


def test_nothing_is_tried_again_where_all_fit(search):
    solution, progress, calls = search("database.db")
    assert solution.registered == PHOTOGRAPHS and calls == [("database.db", False)] and not progress.messages


def test_guided_matching_follows_weaker_matches(guided):
    solution, progress, calls, folder = guided
    assert calls == [("database.db", False), ("database.db", True), ("database_guided.db", True)]
    assert solution.registered == PHOTOGRAPHS
    assert progress.messages == [
        "only 3 of 6 photographs fit together; trying with weaker matches",
        "only 3 of 6 photographs fit together; searching more matches in pairs that match",
        "6 of 6 photographs fit together",
    ]
    first, more = (inlier_counts(folder / name, PHOTOGRAPHS) for name in ("database.db", "database_guided.db"))
    assert more.sum() > 1.1 * first.sum() and np.array_equal(more, solution.inliers)
    assert not (folder / "database_mixed.db").exists()


def test_poses_of_guided_matching_follow_the_first_matches(guided):
    solution, _, _, folder = guided
    shared = set()
    with pycolmap.Database.open(folder / "database.db") as database:
        pairs, geometries = database.read_two_view_geometries()
    for pair, geometry in zip(pairs, geometries, strict=True):
        one, other = pycolmap.pair_id_to_image_pair(pair)
        shared |= {(one, int(a)) for a, _ in geometry.inlier_matches} | {(other, int(b)) for _, b in geometry.inlier_matches}
    seen = {(e.image_id, e.point2D_idx) for point in solution.models[0].points3D.values() for e in point.track.elements}
    assert len(seen) > 500 and seen <= shared


def test_fainter_features_are_the_last_resort(search):
    solution, progress, calls = search("database_thorough.db")
    assert calls[2:] == [("database_guided.db", True), ("database_thorough.db", True)]
    assert solution.registered == PHOTOGRAPHS and solution.path.name == "database_thorough.db"
    assert "searching for fainter features" in progress.messages[-2]


def test_what_fits_best_is_kept_where_nothing_helps(search):
    solution, progress, calls = search()
    assert [name for name, _ in calls[2:]] == ["database_guided.db", "database_thorough.db", "database_thorough_guided.db"]
    assert solution.registered == FEW and progress.messages[-1] == "only 3 of 6 photographs fit together"


def test_poses_of_weak_matches_that_strong_ones_contradict_are_searched_again(search, monkeypatch):
    monkeypatch.setattr(pose_search, "contradicts", lambda model, path: path.name == "database_guided.db")
    solution, progress, _ = search("database_guided.db", "database_thorough.db")
    assert solution.path.name == "database_thorough.db" and not solution.contradicted
    assert progress.messages[2:] == [
        "6 of 6 photographs got poses that some of their matches contradict; searching for fainter features",
        "6 of 6 photographs fit together",
    ]


def test_contradicted_poses_of_few_more_photographs_are_not_preferred(tmp_path):
    def solution(count: int, contradicted: bool) -> Solution:
        model = SimpleNamespace(num_reg_images=lambda: count, compute_mean_reprojection_error=lambda: 0.5)
        return Solution([model], tmp_path, Freedom.RADIAL, np.zeros(6), np.zeros((6, 6)), contradicted)

    right, wrong, part = solution(40, False), solution(60, True), solution(20, False)
    assert max(right, wrong, part, key=lambda s: s.quality) is right and max(wrong, part, key=lambda s: s.quality) is wrong


def test_the_search_gives_the_same_twice(search, guided):
    one, other = guided[0], search("database_guided.db")[0]
    poses = [{n: s.models[0].image(n).cam_from_world().matrix() for n in s.models[0].reg_image_ids()} for s in (one, other)]
    assert poses[0].keys() == poses[1].keys() and all(np.array_equal(poses[0][n], poses[1][n]) for n in poses[0])


def test_pairs_of_kept_photographs_keep_their_matches(guided, tmp_path):
    first, changed = (Path(shutil.copy(guided[3] / name, tmp_path)) for name in ("database.db", "database_guided.db"))
    before, wanted = inlier_counts(changed, PHOTOGRAPHS), inlier_counts(first, PHOTOGRAPHS)
    restore_matches(first, changed, {2})
    after = inlier_counts(changed, PHOTOGRAPHS)
    assert np.array_equal(after[2], before[2]) and (before[2] != wanted[2]).any()
    others = np.delete(np.arange(PHOTOGRAPHS), 2)
    assert np.array_equal(after[np.ix_(others, others)], wanted[np.ix_(others, others)])
