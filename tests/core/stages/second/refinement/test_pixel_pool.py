# SPDX-License-Identifier: GPL-3.0-or-later
"""Selection and concatenation of hit lists, and the sides of surfels that pixels see."""

import numpy as np
import torch
from irgspp.core.kernels.trace import HitLists, blend
from irgspp.core.scene.gaussians import surfels
from irgspp.core.stages.second.refinement.pixel_pool import (
    PixelPool,
    facing_side,
    join_lists,
    merge_rays,
    select_rays,
    select_rays_and_gaussians,
)


def random_lists(rays: int, seed: int) -> HitLists:
    rng = np.random.default_rng(seed)
    start = np.concatenate([[0], np.cumsum(rng.integers(0, 5, rays))])
    hits = start[-1]
    weight, distance = rng.random((2, hits)).astype(np.float32)
    return HitLists(start, rng.integers(0, 99, hits).astype(np.int32), weight, distance, rng.random(rays).astype(np.float32))


def ray(lists: HitLists, number: int) -> tuple:
    hits = slice(lists.start[number], lists.start[number + 1])
    return lists.index[hits].tolist(), lists.weight[hits].tolist(), lists.distance[hits].tolist(), lists.left[number]


def test_chosen_rays_keep_their_hits():
    lists, picked = random_lists(30, 0), np.array([0, 3, 4, 17, 29])
    few = select_rays(lists, picked)
    assert few.rays == len(picked)
    assert [ray(few, i) for i in range(few.rays)] == [ray(lists, int(p)) for p in picked]


def test_joined_lists_follow_one_another():
    parts = [random_lists(7, 1), random_lists(0, 2), random_lists(12, 3)]
    together = join_lists(parts)
    assert [ray(together, i) for i in range(together.rays)] == [ray(part, i) for part in parts for i in range(part.rays)]


def test_part_numbers_what_is_met_anew():
    lists, picked = random_lists(30, 4), np.array([17, 3, 3, 29])
    few, met = select_rays_and_gaussians(lists, picked)
    assert few.rays == len(picked) and (np.diff(met) > 0).all()
    for i, p in enumerate(picked):
        index, *rest = ray(few, i)
        assert (met[index].tolist(), *rest) == ray(lists, int(p))


def test_merged_rays_blend_to_the_mean():
    lists, values = random_lists(24, 5), torch.rand(3, 99, generator=torch.Generator().manual_seed(0))
    mean = blend(lists, values).view(6, 4, 3).mean(1)
    assert torch.allclose(blend(merge_rays(lists, 4), values), mean, atol=1e-6)
    assert merge_rays(lists, 1) is lists


def test_surfels_face_the_pixels_that_see_them():
    lists, generator = random_lists(400, 6), torch.Generator().manual_seed(1)
    position, normal, colour = torch.randn(3, 99, 3, generator=generator)
    g = surfels(position.numpy(), torch.nn.functional.normalize(normal, dim=1).numpy(), colour.abs().numpy(), 0.1, 0.9)
    view = torch.nn.functional.normalize(torch.randn(400, 3, generator=generator), dim=1)
    none = torch.zeros(0)
    side = facing_side(g, PixelPool(lists, none, view, view, none, none, none, none))
    vote = np.zeros(99)
    for pixel in range(400):
        for hit in range(lists.start[pixel], lists.start[pixel + 1]):
            vote[lists.index[hit]] += lists.weight[hit] * float(g.normals()[:, lists.index[hit]].double() @ view[pixel].double())
    assert np.abs(vote).min() > 1e-4 and 30 < (vote < 0).sum() < 70
    np.testing.assert_array_equal(side.numpy(), np.where(vote < 0, -1, 1))
