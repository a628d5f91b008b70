# SPDX-License-Identifier: GPL-3.0-or-later
"""Agreement of found poses with the matches of pairs of photographs, which tells models whose parts were put together wrongly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

LINE_ERROR = 4.0  # pixels from the epipolar line within which poses explain a match; the error at which COLMAP verifies matches
# Below this fraction of explained matches a pair contradicts the poses. Of 66 photographs of a skull, mapped in 27 ways, the 21 right
# models explained at least .45 of the matches of each pair that counts; 5 of the 6 wrong ones (positions off by 20 to 50 % of the distance)
# explained less than .4 of two or three pairs. The sixth, by COLMAP's global mapper, had its halves joined by weak pairs only.
MIN_EXPLAINED = 0.4
MAX_CONTRADICTED = 0.01  # fraction of the pairs that may contradict right poses
# Pairs count whose matches are at least this fraction of the most that one of their photographs has with another: those with fewer may show
# patterns that repeat. Before a wallpaper pairs with up to .2 contradicted right poses, about 160 of 1100.
MIN_STRENGTH = 0.25


def contradicts(model: pycolmap.Reconstruction, path: Path) -> bool:
    """Return True if too many pairs of photographs have matches that the poses don't explain.

    The mapper leaves out observations that don't fit, so that a model whose parts don't belong together has small reprojection errors, too.

    Args:
        model: the model.
        path: the database with the matches.
    """
    fractions = explained_fractions(model, path)
    return bool((fractions < MIN_EXPLAINED).sum() > MAX_CONTRADICTED * len(fractions))


def explained_fractions(model: pycolmap.Reconstruction, path: Path) -> np.ndarray:
    """Return the fraction of verified matches near the epipolar lines of the poses, for each pair that counts (M,), 0..1.

    Args:
        model: the model.
        path: the database with the matches.
    """
    registered = set(model.reg_image_ids())
    with pycolmap.Database.open(path) as database:
        pairs, geometries = database.read_two_view_geometries()
        rays = {number: _rays(model, number, database.read_keypoints(number)[:, :2]) for number in registered}
    ends = [pycolmap.pair_id_to_image_pair(pair) for pair in pairs]
    within = [(*end, geometry.inlier_matches) for end, geometry in zip(ends, geometries, strict=True) if registered.issuperset(end)]
    most: dict[int, int] = {}
    for one, other, matches in within:
        most[one], most[other] = (max(most.get(number, 1), len(matches)) for number in (one, other))
    counted = [pair for pair in within if len(pair[2]) >= MIN_STRENGTH * min(most[pair[0]], most[pair[1]])]
    errors = [_line_error(model, one, other, rays[one][m[:, 0]], rays[other][m[:, 1]]) for one, other, m in counted]
    return np.array([(error < LINE_ERROR).mean() for error in errors])


def _rays(model: pycolmap.Reconstruction, number: int, pixels: np.ndarray) -> np.ndarray:
    """Return the rays (N, 3) of pixels (N, 2) in the camera's frame, at depth 1."""
    camera = model.camera(model.image(number).camera_id)
    return np.concatenate([np.asarray(camera.cam_from_img(pixels)).reshape(-1, 2), np.ones((len(pixels), 1))], 1)


def _line_error(model: pycolmap.Reconstruction, one: int, other: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return Sampson's distance (N,) in pixels of matched rays x, y (N, 3) from the epipolar lines of two poses."""
    turn = model.image(other).cam_from_world() * model.image(one).cam_from_world().inverse()
    tx, ty, tz = turn.translation
    essential = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]]) @ turn.rotation.matrix()
    to_other, to_one = x @ essential.T, y @ essential
    slope = np.sqrt((to_other[:, :2] ** 2).sum(1) + (to_one[:, :2] ** 2).sum(1))
    focal = model.camera(model.image(one).camera_id).mean_focal_length()
    return np.abs((y * to_other).sum(1)) / np.maximum(slope, 1e-12) * focal
