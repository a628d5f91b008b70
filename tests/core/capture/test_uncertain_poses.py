# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs of which few points fix the pose are told by how exactly they place the object, and left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from irgspp.core.capture.photograph import Photograph
from irgspp.core.capture.sparse_model import PosedPhotograph, SparseModel
from irgspp.core.capture.uncertain_poses import MAX_WIDENING, mask_widening, place_deviations, without_uncertain_poses
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.scene.camera import Camera, look_at
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

LENS = Lens("PINHOLE", 640, 480, 520.0, 520.0, 320.0, 240.0, ())
VIEWS, POINTS, FEW = 12, 150, 12
ERROR = 0.5  # mean reprojection error, pixels


def pixels(points: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    """Project points (P, 3) into a photograph: (P, 2)."""
    return Camera(LENS.width, LENS.height, LENS.fx, LENS.fy, LENS.cx, LENS.cy, to_world).project(points)[0]


def model(hidden: tuple[int, ...] = ()) -> SparseModel:
    """Cameras around a cloud of points; of the hidden photographs, FEW points at its edge are seen."""
    points = np.random.default_rng(0).normal(scale=0.5, size=(POINTS, 3))
    posed, tracks = [], []
    for i in range(VIEWS):
        angle = 2 * np.pi * i / VIEWS
        to_world = look_at((4 * np.cos(angle), 4 * np.sin(angle), 1.5), (0, 0, 0))
        places = pixels(points, to_world)
        seen = np.argsort(places[:, 0])[:FEW] if i in hidden else np.arange(POINTS)
        posed.append(PosedPhotograph(Photograph(f"p{i}", Path(f"p{i}"), Path(f"p{i}"), LENS.width, LENS.height, "lens"), LENS, to_world))
        tracks.append((seen, np.full(len(seen), i), places[seen]))
    point, photograph, pixel = (np.concatenate(part) for part in zip(*tracks, strict=True))
    colour = np.zeros((POINTS, 3), np.uint8)
    return SparseModel(posed, points, colour, point.astype(np.int32), photograph.astype(np.int32), pixel.astype(np.float32), ERROR, [])


def fitted_place(points: np.ndarray, seen: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    """Fit a pose to noisy pixels (P, 2) of points (P, 3), and return the pixel (2,) of the origin."""

    def moved(change: np.ndarray) -> np.ndarray:
        pose = to_world.copy()
        pose[:3, :3] = to_world[:3, :3] @ Rotation.from_rotvec(change[:3]).as_matrix()
        pose[:3, 3] += change[3:]
        return pose

    found = least_squares(lambda change: (pixels(points, moved(change)) - seen).ravel(), np.zeros(6))
    return pixels(np.zeros((1, 3)), moved(found.x))[0]


def test_deviations_are_those_of_poses_fitted_to_noise():
    given, rng = model(hidden=(5,)), np.random.default_rng(1)
    found = place_deviations(given)
    sigma = ERROR / np.sqrt(np.pi / 2)  # of an axis; the length of such an error has the mean ERROR
    for i in (0, 5):
        rows = given.track_photograph == i
        points, places, to_world = given.position[given.track_point[rows]], given.track_pixel[rows], given.posed[i].to_world
        fits = [fitted_place(points, places + sigma * rng.normal(size=places.shape), to_world) for _ in range(150)]
        assert found[i] == pytest.approx(np.sqrt(np.var(fits, axis=0).sum()), rel=0.2)


def test_a_photograph_of_few_points_is_left_out_with_a_reason():
    kept = without_uncertain_poses(model(hidden=(5,)))
    assert [one.photograph.name for one in kept.posed] == [f"p{i}" for i in range(VIEWS) if i != 5]
    assert [one.name for one in kept.left_out] == ["p5"]
    assert f"only {FEW} points" in kept.left_out[0].reason
    assert kept.track_photograph.max() == VIEWS - 2


def test_photographs_are_kept_where_all_are_certain_or_several_are_not_or_their_cameras_are_given():
    given = replace(model(hidden=(5,)), error=None)
    for one in (model(), model(hidden=(2, 5, 7)), given):
        assert without_uncertain_poses(one) is one


def test_a_photograph_without_enough_points_has_no_certain_place():
    full = model()
    rows = (full.track_photograph != 3) | (full.track_point < 2)
    few = replace(
        full, track_point=full.track_point[rows], track_photograph=full.track_photograph[rows], track_pixel=full.track_pixel[rows]
    )
    found = place_deviations(few)
    assert np.isinf(found[3])
    assert np.isfinite(np.delete(found, 3)).all()
    assert [one.name for one in without_uncertain_poses(few).left_out] == ["p3"]


def test_masks_are_widened_where_features_err():
    exact = model()
    assert mask_widening(exact) == 0
    assert mask_widening(replace(exact, error=4 * ERROR)) == round(40 * float(np.median(place_deviations(exact)))) > 0
    assert mask_widening(replace(exact, error=1000 * ERROR)) == MAX_WIDENING


def test_masks_of_given_cameras_are_not_widened():
    assert mask_widening(replace(model(), error=None)) == 0


def test_points_that_one_of_the_other_photographs_shows_are_left_out_too():
    whole, rare = model(hidden=(5,)), np.arange(0, POINTS, 7)  # only photographs 2 and 5 show these points
    rows = ~np.isin(whole.track_point, rare) | np.isin(whole.track_photograph, (2, 5))
    few = replace(
        whole, track_point=whole.track_point[rows], track_photograph=whole.track_photograph[rows], track_pixel=whole.track_pixel[rows]
    )
    kept = without_uncertain_poses(few)
    assert len(kept.posed) == VIEWS - 1 and len(kept.position) == len(kept.colour) == POINTS - len(rare)
    assert np.bincount(kept.track_point, minlength=len(kept.position)).min() >= 2
