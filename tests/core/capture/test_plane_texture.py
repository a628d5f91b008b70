# SPDX-License-Identifier: GPL-3.0-or-later
"""Texture of the support plane, and the evidence that pixels show it, against a table whose pattern is known."""

import cv2
import numpy as np
import pytest
from irgspp.core.capture.background_evidence import background_evidence, plane_differences
from irgspp.core.capture.plane_texture import plane_texture
from irgspp.core.scene.camera import Camera, look_at
from patterned_table import BOUND, HEIGHT, PLANE, WIDTH, cameras, on_table, pattern, photographs


def behind(texture, camera, mask):
    """Largest difference of the texture from the pattern behind the object, and the known share there."""
    seen, known = texture.seen_by(camera)
    there = (mask > 0) & known
    return np.abs(seen - pattern(*on_table(camera)))[there].mean(), there.sum() / mask.sum()


def test_table_behind_the_object_is_what_other_views_show():
    cams = cameras()
    colours, masks = photographs(cams, np.array([0.9, 0.1, 0.1]))
    texture = plane_texture(colours, cams, masks, PLANE, BOUND)
    error, share = behind(texture, cams[0], masks[0])
    assert error < 0.02 and share > 0.5


def test_thing_that_stands_in_few_views_and_exposure_do_not_count():
    cams = cameras()
    colours, masks = photographs(cams, np.array([0.9, 0.1, 0.1]), np.where(np.arange(10) % 3 == 0, 0.7, 1.0))
    for colour in colours[:2]:
        colour[30:50, 10:40] = 0.95  # somebody's hand
    texture = plane_texture(colours, cams, masks, PLANE, BOUND)
    seen, known = texture.seen_by(cams[4])
    truth = pattern(*on_table(cams[4]))
    gain = np.median(seen[known] / truth[known])
    assert np.abs(seen / gain - truth)[known].mean() < 0.03


def test_nothing_above_the_horizon_is_known():
    cams = cameras()
    level = Camera(WIDTH, HEIGHT, 110.0, 110.0, 60.0, 45.0, look_at((2.2, 0, 0.2), (0, 0, 0.2)))
    colours, masks = photographs(cams, np.array([0.9, 0.1, 0.1]))
    _, known = plane_texture(colours, cams, masks, PLANE, BOUND).seen_by(level)
    assert not known[: HEIGHT // 2].any() and known[HEIGHT // 2 + 4 :].any()


@pytest.mark.parametrize("gain", [1.0, 0.6])
def test_evidence_tells_the_object_from_the_table_also_where_a_prior_is_wrong(gain):
    cams = cameras()
    colours, masks = photographs(cams, np.array([0.5, 0.45, 0.3]), [gain, *[1.0] * 9])
    texture = plane_texture(colours, cams, masks, PLANE, BOUND)
    priors = [np.roll(mask, 4, 1) for mask in masks]
    evidence = background_evidence([plane_differences(texture, *one) for one in zip(colours, cams, priors, strict=True)], priors)
    known = evidence[0] != 0
    assert np.median(evidence[0][known & (masks[0] > 0)]) < -1 and np.median(evidence[0][known & (masks[0] == 0)]) > 1
    right = (evidence[0] > 0) == (masks[0] == 0)
    assert right[known].mean() > 0.9


def test_an_object_like_the_table_gives_no_evidence():
    cams = cameras()
    colours, masks = photographs(cams)
    texture = plane_texture(colours, cams, masks, PLANE, BOUND)
    evidence = background_evidence([plane_differences(texture, *one) for one in zip(colours, cams, masks, strict=True)], masks)
    assert np.abs(np.concatenate([e[m > 0] for e, m in zip(evidence, masks, strict=True)])).mean() < 0.5


def test_without_an_object_yet_there_is_no_evidence():
    cams = cameras(4)
    colours, masks = photographs(cams)
    texture = plane_texture(colours, cams, masks, PLANE, BOUND)
    nothing = [np.zeros_like(mask) for mask in masks]
    evidence = background_evidence([plane_differences(texture, *one) for one in zip(colours, cams, nothing, strict=True)], nothing)
    assert not np.any(evidence)


def balls(cams, radius):
    """Silhouettes (H, W) of balls of another radius in the place of the photographs' ball."""
    found = []
    for camera in cams:
        rays, to = camera.rays(), np.array([0, 0, 0.25]) - camera.centre
        found.append((to @ to - (rays @ to) ** 2 / (rays * rays).sum(-1) < radius**2).astype(np.float32))
    return found


def test_gaps_that_all_masks_fill_are_seen_where_stereo_sees_no_object():
    cams = cameras()
    colours, own = photographs(cams, np.array([0.9, 0.1, 0.1]))
    filled = balls(cams, 0.4)  # all masks are too large
    without = plane_texture(colours, cams, filled, PLANE, BOUND)
    texture = plane_texture(colours, cams, filled, PLANE, BOUND, [*own[:-1], None])
    gap = filled[0] - own[0]
    assert behind(texture, cams[0], gap)[1] > behind(without, cams[0], gap)[1] + 0.1
    assert behind(texture, cams[0], gap)[0] < 0.03


def test_gaps_in_which_views_disagree_are_not_known():
    cams = cameras()
    colours, own = photographs(cams, np.array([0.9, 0.1, 0.1]))
    filled, random = balls(cams, 0.4), np.random.default_rng(0)
    for colour, mask in zip(colours, filled, strict=True):
        colour[mask > 0] = random.random(3)
    without, texture = (plane_texture(colours, cams, filled, PLANE, BOUND, one) for one in (None, own))
    assert texture.known.sum() < without.known.sum() * 1.01


def test_a_plain_wall_on_which_views_agree_is_not_the_table():
    cams = cameras()
    wall = np.array([0.2, 0.45, 0.35])
    colours, _ = photographs(cams, wall)
    filled, rim = balls(cams, 0.45), [np.zeros((HEIGHT, WIDTH), np.float32) for _ in cams]  # stereo sees nothing of the wall
    for colour, mask in zip(colours, filled, strict=True):
        colour[mask > 0] = wall
    without, texture = (plane_texture(colours, cams, filled, PLANE, BOUND, one) for one in (None, rim))
    assert texture.known.sum() < without.known.sum() * 1.01


def test_a_dark_part_is_not_the_table():
    """Views agree that it is dark, and relative to that its faint shading has contrast enough, but each view shows another pattern."""
    cams = cameras()
    colours, _ = photographs(cams, np.array([0.1, 0.1, 0.1]))
    filled, rim = balls(cams, 0.45), [np.zeros((HEIGHT, WIDTH), np.float32) for _ in cams]
    random = np.random.default_rng(0)
    for colour, mask in zip(colours, filled, strict=True):
        shade = cv2.GaussianBlur(random.standard_normal((HEIGHT, WIDTH)).astype(np.float32), (0, 0), 3.0)
        colour[mask > 0] = (0.12 + 0.02 * shade / shade.std())[mask > 0][:, None]
    without, texture = (plane_texture(colours, cams, filled, PLANE, BOUND, one) for one in (None, rim))
    assert texture.known.sum() < without.known.sum() * 1.01
