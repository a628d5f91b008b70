# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth anchors: where stereo's depths are held, and how they pull."""

import numpy as np
import pytest
import torch
from irgspp.core.stages.first.depth_anchors import COMPARED_VIEWS, HALF_LOSS_PARALLAX, DepthAnchors
from irgspp.core.stereo.depth_map import DepthMap
from textured_wall import SOURCES, bent, textured_wall


def stereo(dataset, depths, support=4):
    """Anchors of depth maps in which all views agree."""
    maps = []
    for view, depth, sources in zip(dataset.train, depths, SOURCES, strict=True):
        shape = depth.shape
        normal, cost = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
        maps.append(DepthMap(view.camera, depth, normal, cost, np.full(shape, support, np.uint8), tuple(sources)))
    return DepthAnchors.of_maps(maps)


@pytest.fixture(scope="module")
def wall():
    return textured_wall()


@pytest.fixture(scope="module")
def anchors(wall):
    """Chosen where surfels lie 6 % behind the right half of the wall."""
    dataset, depths = wall
    return stereo(dataset, depths).choose(dataset, bent(dataset, depths, 1.06))


def test_depths_are_held_where_surfels_are_wrong_only(wall, anchors):
    dataset, depths = wall
    for i, (view, depth) in enumerate(zip(dataset.train, depths, strict=True)):
        pixel = anchors.pixel[anchors.begin[i] : anchors.begin[i + 1]].numpy()
        x = (view.camera.centre + depth[..., None] * view.camera.rays()).reshape(-1, 3)[:, 0]
        inner = np.flatnonzero((x > 0.15) & (x < 0.6))
        assert np.isin(inner, pixel).mean() > 0.5  # elsewhere interpolation errs more than is typical
        assert (x[pixel] > -0.1).all()
    assert anchors.chosen


def test_nothing_is_held_where_surfels_lie_as_well(wall):
    dataset, depths = wall
    for factor in (1.0, 1.004):  # less than half a pixel of parallax
        assert len(stereo(dataset, depths).choose(dataset, bent(dataset, depths, factor)).pixel) == 0


def test_nothing_is_held_where_stereo_is_the_wrong_one(wall):
    dataset, depths = wall
    assert len(stereo(dataset, bent(dataset, depths, 1.06)).choose(dataset, depths).pixel) == 0


@pytest.mark.parametrize(("side", "held"), [(2, False), (4, True)])
def test_a_few_pixels_are_not_worth_it(wall, side, held):
    dataset, depths = wall
    patch, spot = np.s_[31 : 31 + side, 41 : 41 + side], [depth.copy() for depth in depths]
    for own, behind in zip(spot, bent(dataset, depths, 1.06), strict=True):
        own[patch] = behind[patch]
    assert (len(stereo(dataset, depths).choose(dataset, spot).pixel) > 0) == held


def test_reflections_are_not_held():
    """Where colours differ from view to view, stereo's depth explains them badly, even if it does so better than the surfels'."""
    dataset, depths = textured_wall(shine=0.15)
    chosen = stereo(dataset, depths).choose(dataset, bent(dataset, depths, 1.06))
    assert len(chosen.pixel) < 0.1 * 4 * 64 * 64 / 2


def test_views_that_disagree_give_no_anchors(wall):
    assert len(stereo(*wall, support=2).pixel) == 0


def rendered(depth: np.ndarray) -> torch.Tensor:
    """Sums of `rasterize` with this depth (H, W) and an opacity of 0.8."""
    sums = torch.zeros(8, *depth.shape)
    sums[-1] = 0.8
    sums[-2] = 0.8 * torch.from_numpy(depth)
    return sums


def test_loss_is_the_parallax_to_the_anchors(wall, anchors):
    dataset, depths = wall
    camera, count = dataset.train[1].camera, int(anchors.begin[2] - anchors.begin[1])
    assert anchors.loss(1, rendered(depths[1]), camera, camera) == pytest.approx(0, abs=1e-6)
    parallax = 0.02 * camera.fx
    expected = count * parallax / (1 + parallax / HALF_LOSS_PARALLAX) / depths[1].size
    assert anchors.loss(1, rendered(1.02 * depths[1]), camera, camera) == pytest.approx(expected, rel=1e-3)


def test_gradient_pulls_the_depth_of_anchors_alone(wall, anchors):
    dataset, depths = wall
    camera, sums = dataset.train[0].camera, rendered(1.02 * depths[0]).requires_grad_()
    anchors.loss(0, sums, camera, camera).backward()
    pulled = torch.zeros(depths[0].size, dtype=torch.bool)
    pulled[anchors.pixel[: anchors.begin[1]].long()] = True
    assert torch.equal(sums.grad[-2].reshape(-1) > 0, pulled)
    assert not sums.grad[:-2].any()


def test_cropped_image_has_the_same_loss(wall, anchors):
    dataset, depths = wall
    full = dataset.train[2].camera
    whole = rendered(1.02 * depths[2])
    cropped = full.cropped(0, 0, 64, 64)
    assert anchors.loss(2, whole, cropped, full) == anchors.loss(2, whole, full, full)
    rows, columns = np.divmod(anchors.pixel[anchors.begin[2] : anchors.begin[3]].numpy(), 64)
    top, left = rows.min(), columns.min()
    cropped = full.cropped(left, top, 64 - left, 64 - top)
    assert anchors.loss(2, whole[:, top:, left:], cropped, full) == pytest.approx(float(anchors.loss(2, whole, full, full)))


def test_state_gives_the_same_anchors(wall, anchors):
    again = DepthAnchors.of_state(anchors.state(), wall[0])
    assert all(torch.equal(getattr(again, name), getattr(anchors, name)) for name in ("begin", "pixel", "depth", "witnesses"))
    assert again.chosen


@pytest.mark.parametrize(
    "change",
    [
        lambda s: s.update(begin=s["begin"].flip(0)),
        lambda s: s.update(begin=s["begin"][1:]),
        lambda s: s.update(pixel=s["pixel"] + 64 * 64),
        lambda s: s.update(pixel=s["pixel"].long()),
        lambda s: s.update(depth=-s["depth"]),
        lambda s: s.update(depth=s["depth"] * torch.nan),
        lambda s: s.update(depth=s["depth"][1:]),
        lambda s: s.update(witnesses=s["witnesses"] + 4),
        lambda s: s.update(witnesses=s["witnesses"][:, : COMPARED_VIEWS - 1]),
        lambda s: s.update(chosen=1),
    ],
)
def test_state_of_other_views_is_refused(wall, anchors, change):
    state = anchors.state()
    change(state)
    with pytest.raises(ValueError, match="other views"):
        DepthAnchors.of_state(state, wall[0])
