# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals and materials fused from views against the known colours of the solid."""

import numpy as np
import pytest
from irgspp.core.surface.material_fusion import fuse_materials


@pytest.fixture(scope="module")
def torus(solids, camera_ring):
    solid = solids["torus"]
    return solid, [solid.view(camera) for camera in camera_ring(24)]


def points_on(solid, count=3000):
    samples = solid.samples(count)
    return samples.position.astype(np.float64), samples.normal.astype(np.float64)


def test_seen_points_get_the_true_material_and_normal(torus, true_colour):
    solid, views = torus
    points, normals = points_on(solid)
    fused = fuse_materials(points, normals, views, solid.samples(50), 0.01)
    seen = fused.weight > 0
    colour = true_colour(points)
    assert seen.mean() > 0.95
    assert np.abs(fused.albedo - colour)[seen].max() < 0.06
    assert np.abs(fused.albedo - colour)[seen].mean() < 0.01
    assert np.abs(fused.roughness - colour[:, 1])[seen].mean() < 0.01
    assert np.abs(fused.metallic - colour[:, 2])[seen].mean() < 0.01
    angle = np.degrees(np.arccos(np.clip((fused.normal * normals).sum(-1), -1, 1)))
    assert angle[seen].mean() < 1


def test_hidden_surfaces_take_nothing_from_what_hides_them(solids, camera_ring):
    """A point inside the sphere is behind its surface in every view."""
    solid = solids["sphere"]
    views = [solid.view(camera) for camera in camera_ring(12)]
    points, normals = points_on(solid, 500)
    assert (fuse_materials(0.8 * points, normals, views, solid.samples(), 0.01).weight == 0).all()
    assert (fuse_materials(points, -normals, views, solid.samples(), 0.01).weight == 0).all()


def test_unseen_points_take_their_nearest_gaussians(solids, camera_ring, true_colour):
    solid = solids["sphere"]
    above = [solid.view(camera) for camera in camera_ring(6, lowest=0.5)]
    points, normals = points_on(solid)
    fused = fuse_materials(points, normals, above, solid.samples(20_000), 0.01)
    below = points[:, 2] < -0.9
    assert (fused.weight[below] == 0).all()
    assert np.abs(fused.albedo - true_colour(points))[below].mean() < 0.05
    assert ((fused.normal * normals).sum(-1)[below] > 0.95).all()


def test_transparent_pixels_have_no_weight(solids, camera_ring):
    solid = solids["sphere"]
    view = solid.view(camera_ring(1, lowest=0.9)[0])
    view.alpha[:] *= 0.4
    points, normals = points_on(solid, 500)
    assert (fuse_materials(points, normals, [view], solid.samples(), 0.01).weight == 0).all()


def test_a_colour_edge_in_depth_does_not_bleed(solids, camera_ring):
    """Background pixels next to the silhouette are far away, so that rims keep their own colour."""
    solid = solids["sphere"]
    views = [solid.view(camera) for camera in camera_ring(12)]
    for view in views:
        behind = view.alpha == 0
        view.alpha[behind], view.depth[behind] = 1, 8.0
        view.albedo[~behind], view.albedo[behind] = 0.25, 1.0
    points, normals = points_on(solid)
    fused = fuse_materials(points, normals, views, solid.samples(), 0.01)
    np.testing.assert_allclose(fused.albedo[fused.weight > 0], 0.25, atol=1e-5)
