# SPDX-License-Identifier: GPL-3.0-or-later
"""Second cut of a ball on a patterned table, whose masks are wrong at their edges, against the true masks."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from irgspp.core.capture.mask_consistency import overlap
from irgspp.core.capture.second_cut import cut_again, edges_settled, support_plane_of
from irgspp.core.scene.dataset import View
from irgspp.core.scene.surroundings import Surroundings
from patterned_table import BOUND, PLANE, cameras, photographs

ERROR = 1.0  # of the masks, pixels
BALL = (0.25, 0.6, 0.35)


@pytest.fixture(scope="module")
def scene():
    """Cameras, photographs and true masks."""
    cams = cameras()
    return cams, *photographs(cams, BALL)


def wrong(mask, i):
    """A mask grown in even views, shrunk in odd ones, and soft at its edge."""
    change = cv2.dilate if i % 2 == 0 else cv2.erode
    return cv2.GaussianBlur(change(mask, np.ones((3, 3), np.uint8)), (0, 0), 0.6)


def views_of(scene):
    return [View(f"v{i}", c, Path("v.png"), p, wrong(m, i), mask_error=ERROR) for i, (c, p, m) in enumerate(zip(*scene, strict=True))]


def rendered(scene, opacity):
    """Renderings of a ball of the right colour, with an opacity (H, W) of each true mask."""
    return [(np.broadcast_to(np.float32(BALL), photo.shape), opacity(mask)) for photo, mask in zip(*scene[1:], strict=True)]


def test_edges_follow_the_photographs(scene):
    """The rendered outline is blurred, as that of a fit to such masks is; only the colours know the true edge."""
    views = views_of(scene)
    again = cut_again(views, rendered(scene, lambda mask: cv2.GaussianBlur(mask, (0, 0), 2)), PLANE, BOUND)
    before, after = ([overlap(view.alpha, mask) for view, mask in zip(some, scene[2], strict=True)] for some in (views, again))
    assert min(after) > 0.94 and max(before) < 0.85
    assert all(view.mask_error == ERROR / 2 and view.cut_by_colours for view in again)
    assert all(((view.alpha > 0.1) & (view.alpha < 0.9)).sum() / (view.alpha > 0.5).sum() > 0.05 for view in again)  # coverage


def test_pixels_that_mix_both_colours_are_shared_out(scene):
    """A table whose colours vary little must not leave all mixed pixels to the object: the outline would be too wide."""
    cams, photos, masks = scene
    blurred = [cv2.GaussianBlur(photo, (0, 0), 1.2) for photo in photos]
    views = views_of((cams, blurred, masks))
    again = cut_again(views, rendered(scene, lambda mask: cv2.GaussianBlur(mask, (0, 0), 2)), PLANE, BOUND)
    wider = [float((view.alpha - mask).sum() / np.abs(np.diff(mask)).sum()) for view, mask in zip(again, masks, strict=True)]
    assert abs(np.mean(wider)) < 0.14  # 0.18 by the likelihood ratio alone


def test_masks_that_would_change_too_much_are_kept(scene):
    views = views_of(scene)
    empty = [replace(view, alpha=np.zeros_like(view.alpha)) if i == 3 else view for i, view in enumerate(views)]
    again = cut_again(empty, rendered(scene, lambda mask: mask), PLANE, BOUND)
    assert again[3].alpha is empty[3].alpha and again[3].mask_error == ERROR and not again[3].cut_by_colours


def test_support_plane_is_that_of_the_surroundings():
    place = np.random.default_rng(0).uniform(-1, 1, (80, 3)).astype(np.float32) * (1, 1, 0)
    up = np.tile(np.float32([0, 0, 1]), (80, 1))
    around = Surroundings(place.astype(np.float32), up, up, np.full(80, 0.1, np.float32))
    assert support_plane_of(around).normal.tolist() == [0, 0, 1]
    assert support_plane_of(None) is None
    assert support_plane_of(replace(around, position=around.position + np.float32(0.5))) is None
    assert support_plane_of(replace(around, normal=-up)) is None


def test_edges_settle_once_a_cut_hardly_moves_them(scene):
    true = [replace(view, alpha=mask) for view, mask in zip(views_of(scene), scene[2], strict=True)]
    grown = [replace(view, alpha=cv2.dilate(view.alpha, np.ones((3, 3), np.uint8))) for view in true]
    assert edges_settled(true, true) and not edges_settled(true, grown) and not edges_settled(grown, true)
    assert not edges_settled([replace(view, mask_error=0.0) for view in true], grown)
    wider = [replace(view, mask_error=5.0) for view in true]
    assert edges_settled(wider, grown)  # by one pixel, a fifth of the error
    empty = [replace(view, alpha=np.zeros_like(view.alpha)) for view in true]
    assert edges_settled(empty, true)
