# SPDX-License-Identifier: GPL-3.0-or-later
"""Agreement of poses with matches: full where a model is right, and lost where a part of it was put in the wrong place."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from irgspp.core.capture.model_agreement import contradicts, explained_fractions

PHOTOGRAPHS = 8


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> tuple[Path, pycolmap.Reconstruction]:
    """Cameras around points, and a database with their matches, 1 % of them wrong."""
    path = tmp_path_factory.mktemp("agreement") / "database.db"
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 1, PHOTOGRAPHS, 200
    options.inlier_match_ratio = 0.99
    pycolmap.set_random_seed(0)
    with pycolmap.Database.open(path) as database:
        return path, pycolmap.synthesize_dataset(options, database)


def moved(model: pycolmap.Reconstruction, numbers: list[int]) -> pycolmap.Reconstruction:
    """Return a copy in which some photographs stand elsewhere, together, as a part of a model that was joined wrongly."""
    copy = pycolmap.Reconstruction(model)
    turn = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.2, 0.9, 0.1]) * np.radians(40)), np.array([0.5, 0.2, 0.3]))
    for number in numbers:
        frame = copy.frame(copy.image(number).frame_id)
        frame.rig_from_world = frame.rig_from_world * turn
    return copy


def test_right_poses_explain_their_matches(scene):
    path, model = scene
    fractions = explained_fractions(model, path)
    assert len(fractions) == PHOTOGRAPHS * (PHOTOGRAPHS - 1) // 2 and fractions.min() > 0.9 and not contradicts(model, path)


def test_a_part_in_the_wrong_place_contradicts_its_matches_with_the_rest(scene):
    path, model = scene
    wrong = moved(model, sorted(model.reg_image_ids())[:3])
    fractions = explained_fractions(wrong, path)
    assert contradicts(wrong, path)
    assert (fractions > 0.9).sum() == 3 + 10  # pairs within the part, and within the rest


def test_only_pairs_of_the_model_count(scene):
    path, model = scene
    part = pycolmap.Reconstruction(model)
    part.deregister_frame(part.image(min(part.reg_image_ids())).frame_id)
    assert len(explained_fractions(part, path)) == (PHOTOGRAPHS - 1) * (PHOTOGRAPHS - 2) // 2
