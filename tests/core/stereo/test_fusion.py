# SPDX-License-Identifier: GPL-3.0-or-later
"""Fused points of exact depth maps of a sphere: on the sphere, outward, in its colours, each place once."""

from dataclasses import replace

import numpy as np
import pytest
from irgspp.core.stereo.consistency import support
from irgspp.core.stereo.depth_map import DepthMap, camera_matrices
from irgspp.core.stereo.fusion import fuse_points
from irgspp.core.stereo.settings import StereoSettings

SETTINGS = StereoSettings()


@pytest.fixture(scope="module")
def exact_maps(sphere):
    """Exact depth and normals as depth maps with the support that they find in each other."""
    maps, count = [], len(sphere.views)
    for i, (view, depth, normal) in enumerate(zip(sphere.views, sphere.depth, sphere.normal, strict=True)):
        cost = np.where(depth > 0, 0.1, 2).astype(np.float32)
        layers = depth.astype(np.float32), normal.astype(np.float32), cost, np.zeros(depth.shape, np.uint8)
        maps.append(DepthMap(view.camera, *layers, tuple(k for k in range(count) if k != i)))
    return [replace(one, support=support(one, [maps[k] for k in one.witnesses], SETTINGS)) for one in maps]


def support_by_definition(one, witnesses):
    """As `support`, in plain numpy."""
    count = np.zeros(one.depth.shape, int)
    own = np.argwhere((one.depth > 0) & (one.cost <= SETTINGS.largest_cost))
    for other in witnesses:
        for r, c in own:
            pixel, z = other.camera.project(one.points()[r, c][None])
            v, u = (int(np.floor(p)) for p in pixel[0][::-1])
            if not (0 <= v < other.depth.shape[0] and 0 <= u < other.depth.shape[1]) or other.depth[v, u] <= 0:
                continue
            back, _ = one.camera.project(other.points()[v, u][None])
            near = np.linalg.norm(back[0] - (c + 0.5, r + 0.5)) <= SETTINGS.reprojection
            like = one.normal[r, c] @ other.normal[v, u] > SETTINGS.cosine
            count[r, c] += near and like and abs(other.depth[v, u] - z[0]) <= SETTINGS.relative_depth * z[0]
    return count


def test_support_is_as_defined(exact_maps):
    small = replace(exact_maps[2], depth=np.where(np.arange(64) % 7 == 0, exact_maps[2].depth, 0).astype(np.float32))
    witnesses = [exact_maps[1], exact_maps[5]]
    expected = support_by_definition(small, witnesses)
    found = support(small, witnesses, SETTINGS)
    assert expected.max() == 2 and (found != expected).mean() < 1e-3  # float32 rays may round to the next pixel


@pytest.mark.parametrize(
    "wrong",
    [
        lambda m: replace(m, depth=(1.03 * m.depth).astype(np.float32)),
        lambda m: replace(m, normal=-m.normal),
        lambda m: replace(m, cost=np.full_like(m.cost, 0.5)),
    ],
    ids=["depth", "normal", "cost"],
)
def test_wrong_maps_have_no_support(exact_maps, wrong):
    one = wrong(exact_maps[2])
    assert (
        support(one, [exact_maps[1], exact_maps[3]], SETTINGS) == 0
    ).mean() > 0.97  # near the rim a wrong depth may meet the surface elsewhere


def test_points_lie_on_the_sphere_and_look_outward(sphere, exact_maps):
    cloud = fuse_points(exact_maps, [view.colour for view in sphere.views])
    radius = np.linalg.norm(cloud.position, axis=-1)
    assert np.abs(radius - 1).max() < 0.01 and np.median(np.abs(radius - 1)) < 1e-3
    assert (cloud.normal * cloud.position).sum(-1).min() > 0.99
    assert np.allclose(np.linalg.norm(cloud.normal, axis=-1), 1, atol=1e-5)
    assert np.median(cloud.support) >= 3 and cloud.support.min() >= 1 and cloud.support.max() <= len(exact_maps)


def test_each_place_gives_one_point(sphere, exact_maps):
    """Fewer points than supported pixels, more than one view's."""
    cloud = fuse_points(exact_maps, [view.colour for view in sphere.views])
    supported = [int((one.support >= 2).sum()) for one in exact_maps]
    assert max(supported) < len(cloud.position) < 0.5 * sum(supported)


def test_colours_are_means_of_the_views(sphere, exact_maps):
    colours = [np.full_like(view.colour, i / 10) for i, view in enumerate(sphere.views)]
    cloud = fuse_points(exact_maps, colours)
    everywhere = cloud.support == len(exact_maps)
    assert everywhere.any() and np.allclose(cloud.colour[everywhere], np.mean(np.arange(6) / 10), atol=1e-6)
    assert cloud.colour.min() >= 0 and cloud.colour.max() <= 0.5


def test_no_support_gives_no_points(sphere, exact_maps):
    cloud = fuse_points(exact_maps, [view.colour for view in sphere.views], min_support=200)
    assert cloud.position.shape == cloud.normal.shape == cloud.colour.shape == (0, 3) and cloud.support.shape == (0,)


def test_camera_matrices_are_inverse(camera_arc):
    camera = camera_arc()[1]
    forth, back = camera_matrices(camera)
    point = np.array([0.3, -0.2, 0.1])
    u, v, d = forth @ [*point, 1]
    pixel, depth = camera.project(point[None])
    assert np.allclose([u / d, v / d], pixel[0]) and d == pytest.approx(depth[0])
    assert np.allclose(back @ [u, v, d, 1], point)
