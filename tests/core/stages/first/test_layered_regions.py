# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions in which points lie in several layers."""

import numpy as np
import pytest
from irgspp.core.stages.first.layered_regions import layered_regions


@pytest.fixture
def sphere():
    """Points (30000, 3) spread evenly over the unit sphere, which are its normals, too."""
    index = np.arange(30000) + 0.5
    z, azimuth = 1 - 2 * index / 30000, np.pi * (1 + 5**0.5) * index
    return np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], 1)


def test_a_cap_with_points_below_the_surface_is_one_region(sphere):
    cap = sphere[sphere[:, 2] > 0.8]
    points = np.concatenate([sphere, *(depth * cap for depth in (0.97, 0.94, 0.91))])
    regions = layered_regions(points, np.concatenate([sphere, cap, cap, cap]), 1.0)
    assert len(regions) == 1
    height = points[:, 2] / np.linalg.norm(points, axis=1)
    assert regions[0][height > 0.85].mean() > 0.98
    assert not regions[0][height < 0.7].any()


def test_two_caps_are_two_regions_the_larger_first(sphere):
    large, small = sphere[sphere[:, 2] > 0.7], sphere[sphere[:, 2] < -0.85]
    points = np.concatenate([sphere, 0.93 * small, 0.93 * large])
    regions = layered_regions(points, np.concatenate([sphere, small, large]), 1.0)
    assert [points[region][:, 2].mean() > 0 for region in regions] == [True, False]
    assert regions[0].sum() > regions[1].sum()
    assert not (regions[0] & regions[1]).any()


def test_one_noisy_layer_is_none(sphere):
    noisy = sphere * np.random.default_rng(0).normal(1, 0.01, (len(sphere), 1))
    assert layered_regions(noisy, sphere, 1.0) == []


def test_the_two_sides_of_a_thin_part_are_none():
    across = np.stack(np.meshgrid(*[np.linspace(-1, 1, 150)] * 2), -1).reshape(-1, 2)
    up = np.tile([0.0, 0.0, 1.0], (len(across), 1))
    points = np.concatenate([np.pad(across, ((0, 0), (0, 1)), constant_values=height) for height in (0.0, 0.07)])
    assert layered_regions(points, np.concatenate([-up, up]), 1.0) == []
    assert len(layered_regions(points, np.concatenate([up, up]), 1.0)) == 1


def test_few_points_have_no_regions(sphere):
    assert layered_regions(sphere[:32], sphere[:32], 1.0) == []
    assert layered_regions(sphere[:0], sphere[:0], 1.0) == []
