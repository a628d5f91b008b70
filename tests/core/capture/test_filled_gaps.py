# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaps that masks fill: the second cut opens them where several photographs see the table in them, and nowhere else."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from irgspp.core.capture.filled_gaps import carved_silhouettes, gaps_in
from irgspp.core.capture.mask_consistency import overlap
from irgspp.core.capture.second_cut import cut_again
from irgspp.core.scene.dataset import View
from patterned_table import BOUND, PLANE, cameras, photographs

ERROR = 1.0  # of the masks, pixels
BALL = (0.25, 0.6, 0.35)
PLACE, RADIUS = np.array([0.0, 0.3, 0.15]), 0.13  # of a second ball, which the masks contain and the photographs do not show


@pytest.fixture(scope="module")
def scene():
    """Cameras, photographs, true masks, and masks that fill a second ball, too."""
    cams = cameras(16)
    photos, masks = photographs(cams, BALL)
    return cams, photos, masks, [np.maximum(mask, ball_mask(camera)) for mask, camera in zip(masks, cams, strict=True)]


def ball_mask(camera):
    rays, to = camera.rays(), PLACE - camera.centre
    along = (rays @ to) ** 2 / (rays * rays).sum(-1)
    return (to @ to - along < RADIUS**2).astype(np.float32)


def views_of(cams, photos, masks):
    return [View(f"v{i}", c, Path("v.png"), p, m, mask_error=ERROR) for i, (c, p, m) in enumerate(zip(cams, photos, masks, strict=True))]


def rendered(filled, masks):
    """Renderings of what such masks are fitted with: the ball, and something of the table's mean colour in the gap."""
    table = np.float32([0.5, 0.45, 0.3])
    pairs = zip(filled, masks, strict=True)
    return [(np.where(mask[..., None] > 0, np.float32(BALL), table), cv2.GaussianBlur(full, (0, 0), 1)) for full, mask in pairs]


def test_a_gap_that_all_masks_fill_is_opened(scene):
    cams, photos, masks, filled = scene
    again = cut_again(views_of(cams, photos, filled), rendered(filled, masks), PLANE, BOUND)
    before, after = ([overlap(one, mask) for one, mask in zip(some, masks, strict=True)] for some in (filled, [v.alpha for v in again]))
    assert np.mean(before) < 0.9 and np.mean(after) > 0.95
    assert sum(new > old for old, new in zip(before, after, strict=True)) >= len(cams) - 4  # in some the second ball is behind the first


def test_a_mirrored_patch_in_one_photograph_stays(scene):
    """One photograph shows the table's colours on the ball, as a gloss would; the others see the ball there."""
    cams, photos, masks, _ = scene
    table = photographs(cams[:1], None)[0][0]
    patch = np.zeros(masks[0].shape, bool)
    rows, columns = np.nonzero(masks[0])
    patch[int(rows.mean()) - 5 : int(rows.mean()) + 5, int(columns.mean()) - 5 : int(columns.mean()) + 5] = True
    mirrored = [np.where(patch[..., None], table, photos[0]), *photos[1:]]
    again = cut_again(views_of(cams, mirrored, masks), rendered(masks, masks), PLANE, BOUND)
    assert (again[0].alpha[patch] > 0.5).all()


def test_pixels_need_both_colours_and_other_views():
    inside = np.ones((5, 40), bool)
    evidence = np.full((5, 40), -2.0)
    evidence[:, 10] = evidence[:, 20] = 2.0
    silhouette = np.ones((5, 40))
    silhouette[:, 10], silhouette[:, 30] = 0.9, 0.3
    found = gaps_in(inside, evidence, silhouette)
    assert np.flatnonzero(found[2]).tolist() == [9, 10, 11, 29, 30, 31]
    assert not gaps_in(~inside, evidence, silhouette).any()


def test_masks_without_a_common_place_are_left_alone(scene):
    cams, photos, masks, _ = scene
    nothing = [np.zeros(mask.shape, bool) for mask in masks]
    assert carved_silhouettes(cams, nothing, BOUND, PLANE) is None
    views = [replace(view, alpha=np.zeros_like(view.alpha)) for view in views_of(cams, photos, masks)]
    assert all(one is view for one, view in zip(cut_again(views, rendered(masks, masks), PLANE, BOUND), views, strict=True))
