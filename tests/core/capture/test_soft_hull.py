# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft hull of exact masks of a box: its silhouettes, and what one wrong mask does to it."""

import cv2
import numpy as np
import pytest
from irgspp.core.capture.mask_consistency import overlap
from irgspp.core.capture.soft_hull import silhouettes, soft_hull
from irgspp.core.capture.support_plane import SupportPlane
from irgspp.core.scene.dataset import Bound

BOUND = Bound((0.0, 0.0, 0.5), 0.75)


@pytest.fixture(scope="module")
def exact(table_scene):
    return [view.camera for view in table_scene.views], [table_scene.masks[view.name] for view in table_scene.views]


def test_silhouettes_of_exact_masks_are_the_masks(exact):
    cameras, masks = exact
    hull = soft_hull(cameras, masks, np.ones(len(masks)), BOUND, None)
    assert hull is not None
    assert min(overlap(a, b) for a, b in zip(silhouettes(hull, cameras), masks, strict=True)) > 0.85


def test_voxels_fill_the_box_above_the_plane(exact):
    cameras, masks = exact
    table = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.0, np.empty((0, 3)))
    hull = soft_hull(cameras, masks, np.ones(len(masks)), BOUND, table)
    assert hull is not None
    low, high = hull.points().min(0), hull.points().max(0)
    assert np.allclose(high - low, (0.64, 0.48, 1.0), atol=0.12)


def test_silhouette_of_a_view_ignores_its_own_mask(exact):
    cameras, masks = exact
    wrong = [np.ones_like(masks[0]), *masks[1:]]
    hull = soft_hull(cameras, wrong, np.ones(len(masks)), BOUND, None)
    assert hull is not None
    assert overlap(hull.silhouette(cameras[0], 0), masks[0]) > 0.8


def test_a_mask_without_weight_carves_nothing(exact):
    cameras, masks = exact
    empty = [np.zeros_like(masks[0])] * 3 + masks[3:]
    weights = np.array([0.0] * 3 + [1.0] * (len(masks) - 3))
    assert soft_hull(cameras, empty, np.ones(len(masks)), BOUND, None) is None
    assert soft_hull(cameras, empty, weights, BOUND, None) is not None


def test_thin_parts_stay_where_masks_are_widened_by_the_poses_error(exact):
    """Masks of a narrow bar, each moved by 3 pixels in its own direction, as poses that err would: they have little in common."""
    cameras, _ = exact
    along = np.linspace(0, 1, 200)
    bar, moved = [], []
    for i, camera in enumerate(cameras):
        pixel, _ = camera.project(np.stack([0.4 * along - 0.2, 0.1 * along, 0.3 + 0.4 * along], 1))
        image = np.zeros((camera.height, camera.width), np.uint8)
        cv2.polylines(image, [np.round(pixel).astype(np.int32)], False, 1, 5)
        bar.append(image.astype(np.float32))
        moved.append(np.roll(bar[-1], [(0, 3), (3, 0), (0, -3), (-3, 0)][i % 4], (0, 1)))
    strict, loose = (soft_hull(cameras, moved, np.ones(len(cameras)), BOUND, None, error) for error in (0, 3))
    assert loose is not None
    covered = [silhouette[mask > 0].mean() for silhouette, mask in zip(silhouettes(loose, cameras), bar, strict=True)]
    assert np.mean(covered) > 0.8
    assert strict is None or np.mean([s[m > 0].mean() for s, m in zip(silhouettes(strict, cameras), bar, strict=True)]) < 0.5
