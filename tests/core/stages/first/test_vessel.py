# SPDX-License-Identifier: GPL-3.0-or-later
"""Vessel: an open bowl with a plain inside, of which stereo knows nothing for sure."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.datasets.visual_hull import visual_hull
from irgspp.core.progress.protocol import Silent
from irgspp.core.stages.first import stereo_initialization
from irgspp.core.stages.first import vessel as vessel_module
from irgspp.core.stages.first.stereo_initialization import from_stereo, hull_bounds
from irgspp.core.stages.first.vessel import MIN_RELATIVE_DEPTH, MIN_TELLING_DEPTH, THICKNESSES, UNKNOWN_THICKNESS, find_vessel
from irgspp.core.stages.first.vessel_mouths import vessel_mouths
from open_bowl import RIM, bowl, bowl_depth, guessed_inside

COUNT = 10_000


@pytest.fixture(scope="module")
def dataset():
    return bowl()


@pytest.fixture(scope="module")
def hull(dataset):
    return visual_hull(dataset.train, dataset.bound)


@pytest.fixture(scope="module")
def surface(hull):
    return hull.sample(COUNT, np.random.default_rng(0))[:2]


@pytest.fixture(scope="module")
def hull_depth(dataset, hull):
    return hull_bounds(dataset, hull)[2]


def found(dataset, hull, surface, hull_depth, part, least_depth=MIN_RELATIVE_DEPTH):
    """Vessel that depths tell which lie a `part` of the way from the hull to the bowl's inside."""
    maps = [
        replace(one, depth=depth + part * (one.depth - depth)) for one, depth in zip(guessed_inside(dataset.train), hull_depth, strict=True)
    ]
    return find_vessel(hull, surface, maps, hull_depth, dataset.bound.radius, least_depth)


def test_the_hollow_lies_behind_the_mouth(dataset, hull, surface, hull_depth):
    vessel = found(dataset, hull, surface, hull_depth, 1.0)
    assert vessel.thickness == pytest.approx(THICKNESSES[0] * dataset.bound.radius)  # the thinnest: the bowl's wall has no thickness
    assert vessel.closing[:, 2] == pytest.approx(RIM, abs=0.15)  # the lid of the hull bulges
    cells = hull.corner + hull.step * np.argwhere(vessel.hollow)
    assert np.linalg.norm(cells[np.abs(cells[:, 2] + 0.4) < 0.4], axis=1).max() < 1.0  # the hull is larger at the bottom
    inner = np.linalg.norm(hull.corner + hull.step * np.argwhere(hull.inside > 0.5), axis=1) < 0.9
    assert vessel.hollow.sum() > 0.95 * inner.sum()


def test_points_of_the_inside_lie_one_wall_from_the_outside_and_face_the_hollow(dataset, hull, surface, hull_depth):
    vessel = found(dataset, hull, surface, hull_depth, 1.0)
    points, normals, area = vessel.surface(COUNT, np.random.default_rng(0))
    low = points[:, 2] < -0.2  # where views from the side do not let the hull grow below the bowl
    low &= points[:, 2] > -0.8
    assert 0.3 * COUNT < len(points) < 0.6 * COUNT and area > hull.sample(10, np.random.default_rng(0))[2]
    assert np.linalg.norm(points[low], axis=1) == pytest.approx(1 - vessel.thickness, abs=2.5 * hull.step)
    assert np.quantile(-(points * normals).sum(1)[low], 0.1) > 0.9


def test_points_in_the_hollow_and_of_the_outside_are_told_apart(dataset, hull, surface, hull_depth):
    vessel = found(dataset, hull, surface, hull_depth, 1.0)
    middle, lid, wall, outside = np.array([[0, 0, -0.3], [0, 0, RIM], [0.96, 0, -0.1], [0.995, 0, -0.1]])
    assert vessel.is_in_hollow(np.stack([middle, lid, wall, outside]), 0.05).tolist() == [True, True, False, False]
    outwards, inwards = np.array([[1.0, 0, 0]]), np.array([[-1.0, 0, 0]])
    assert vessel.faces_wall(wall[None], outwards).tolist() == [True]
    assert vessel.faces_wall(wall[None], inwards).tolist() == [False]
    assert vessel.faces_wall(outside[None], outwards).tolist() == [False]


@pytest.mark.parametrize(("part", "is_one"), [(0.55, False), (1.0, True)])
def test_a_vessel_is_asked_for_that_depths_tell_for_sure(dataset, hull, surface, hull_depth, part, is_one):
    assert (found(dataset, hull, surface, hull_depth, part, MIN_TELLING_DEPTH) is not None) == is_one


@pytest.mark.parametrize("part", [0.0, 0.25])
def test_depths_near_the_hull_are_no_vessel(dataset, hull, surface, hull_depth, part):
    assert found(dataset, hull, surface, hull_depth, part) is None


def test_depths_halfway_tell_a_mouth_but_not_the_thickness(dataset, hull, surface, hull_depth):
    vessel = found(dataset, hull, surface, hull_depth, 0.55)
    assert vessel.thickness == pytest.approx(UNKNOWN_THICKNESS * dataset.bound.radius)


def test_where_all_of_the_hull_is_looked_through_there_is_no_vessel(hull, surface, hull_depth, dataset, monkeypatch):
    monkeypatch.setattr(vessel_module, "vessel_mouths", lambda points, *_: [np.ones(len(points), bool)])
    assert found(dataset, hull, surface, hull_depth, 1.0) is None


def test_a_hole_in_a_mouth_is_filled(dataset, surface, hull_depth):
    """In a small part of the mouth, depths lie on the hull, as where a handle is in front of it."""
    maps = guessed_inside(dataset.train)
    for one, depth in zip(maps, hull_depth, strict=True):
        points = one.camera.centre + depth[..., None] * one.camera.rays()
        one.depth[np.linalg.norm(points - [0.3, 0, RIM], axis=-1) < 0.05] = 0
    mouth = vessel_mouths(*surface, maps, hull_depth, dataset.bound.radius)[0]
    hole = np.linalg.norm(surface[0] - [0.3, 0, RIM], axis=1) < 0.06
    assert hole.sum() > 3 and mouth[hole].all()
    assert np.abs(surface[0][mouth][:, 2] - RIM).max() < 0.15


def start_with(dataset, monkeypatch, maps):
    """Start of the bowl as a vessel, by depth maps."""
    monkeypatch.setattr(stereo_initialization, "estimate_depth_maps", lambda *_: maps)
    (closed,) = from_stereo(dataset, COUNT, 0, Silent(), everywhere=True)
    return closed, closed.vessel(MIN_RELATIVE_DEPTH)


def test_surfels_of_a_vessel_lie_on_its_inside_and_not_on_its_mouth(dataset, monkeypatch):
    closed, vessel = start_with(dataset, monkeypatch, guessed_inside(dataset.train))
    assert vessel.name == "stereo everywhere as a vessel"
    assert vessel.gaussians.count <= COUNT
    share = {}
    for start in (closed, vessel):
        place, normal = start.gaussians.position.T.numpy(), start.gaussians.normals().T.numpy()
        far = np.linalg.norm(place, axis=1) < 0.85
        share[start.name] = far.mean(), ((place * normal).sum(1) < -0.8).mean()
    (lid, inside), (vessel_lid, vessel_inside) = share[closed.name], share[vessel.name]
    assert lid > 0.1 and vessel_lid < 0.25 * lid
    assert inside < 0.02 and vessel_inside > 0.3


def test_what_stands_in_a_vessel_is_kept(dataset, monkeypatch):
    """A pillar in the bowl, on whose points views agree, is not in the way of most views."""
    maps = []
    for one in guessed_inside(dataset.train):
        rays = one.camera.rays().astype(np.float64)
        # A vertical disc at y = 0, seen from both sides, about the height of the bowl.
        t = -one.camera.centre[1] / np.where(np.abs(rays[..., 1]) > 1e-9, rays[..., 1], 1e-9)
        hit = one.camera.centre + t[..., None] * rays
        first = bowl_depth(one.camera, rays)
        shown = (np.hypot(hit[..., 0], hit[..., 2] + 0.3) < 0.25) & (t > 0) & (t < first)
        side = np.sign(one.camera.centre[1])
        depth = np.where(shown, t, one.depth).astype(np.float32)
        normal = np.where(shown[..., None], [0, side, 0], one.normal).astype(np.float32)
        maps.append(replace(one, depth=depth, normal=normal, support=np.where(shown, 5, one.support).astype(np.uint8)))
    _, vessel = start_with(dataset, monkeypatch, maps)
    place = vessel.gaussians.position.T.numpy()
    assert ((np.abs(place[:, 1]) < 0.02) & (np.hypot(place[:, 0], place[:, 2] + 0.3) < 0.25)).sum() > 30


def test_a_solid_object_is_no_vessel(dataset, monkeypatch):
    """All depths lie on the hull."""
    flat = [
        replace(one, depth=depth)
        for one, depth in zip(
            guessed_inside(dataset.train), hull_bounds(dataset, visual_hull(dataset.train, dataset.bound))[2], strict=True
        )
    ]
    _, vessel = start_with(dataset, monkeypatch, flat)
    assert vessel is None


def test_a_vessel_whose_inside_stereo_finds_needs_no_other_start(dataset, monkeypatch):
    maps = [replace(one, support=np.where(one.depth > 0, 5, 0).astype(np.uint8)) for one in guessed_inside(dataset.train)]
    closed, vessel = start_with(dataset, monkeypatch, maps)
    assert (np.linalg.norm(closed.gaussians.position.T.numpy(), axis=1) < 0.85).mean() < 0.02
    assert vessel is None
