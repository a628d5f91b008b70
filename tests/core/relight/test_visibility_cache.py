# SPDX-License-Identifier: GPL-3.0-or-later
"""Visibility cache: no direction is clear where few rays were traced or near one that met something."""

import torch
from irgspp.core.relight.indirect_light import HitReflectance, SecondaryRays
from irgspp.core.relight.visibility_cache import BINS, VisibilityCache, build_visibility_cache

WIDTH, RAYS = 8, 4000


def rays(met: torch.Tensor, above: torch.Tensor) -> SecondaryRays:
    """Rays of 16 points, RAYS in all: those `met` have a hit, those `above` lie above the horizon."""
    row = torch.where(met, 0, -1).int()
    nothing = torch.zeros(1, 3)
    hits = HitReflectance(torch.ones(1), nothing, nothing, torch.zeros(1, 5), nothing.int(), nothing)
    return SecondaryRays(above[..., None].float().repeat(1, 1, 6), row, hits)


def scene():
    """A patch of 4 x 4 pixels with rays in all directions, unoccluded except for a cone about +X."""
    direction = torch.nn.functional.normalize(torch.randn(16, RAYS // 16, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    above = direction[..., 2] > 0
    return direction, rays((direction[..., 0] > 0.8) & above, above), (torch.arange(16) // 4) * WIDTH + torch.arange(16) % 4


def clear_of(visibility_cache: VisibilityCache, direction) -> bool:
    """Look a direction above the horizon up by the definition of the octahedral map (Engelhardt and Dachsbacher 2008)."""
    x, y, z = direction
    size = abs(x) + abs(y) + abs(z)
    column, row = (min(int((c / size / 2 + 0.5) * BINS), BINS - 1) for c in (x, y))
    return bool(visibility_cache.clear[visibility_cache.tile[0], row * BINS + column])


def test_directions_are_clear_where_many_rays_met_nothing():
    visibility_cache = build_visibility_cache(*scene(), WIDTH)
    assert visibility_cache.tile.tolist() == [0] * 16
    assert all(clear_of(visibility_cache, d) for d in ((0, 0, 1), (0, 0.7, 0.7), (0, -0.7, 0.7), (-0.7, 0, 0.7)))
    assert not any(clear_of(visibility_cache, d) for d in ((1, 0, 0.01), (0.9, 0, 0.4), (0.8, 0.4, 0.4)))


def test_nothing_is_clear_below_the_horizon_or_after_few_rays():
    direction, traced, index = scene()
    assert 0.2 < build_visibility_cache(direction, traced, index, WIDTH).clear.float().mean() < 0.6
    few = SecondaryRays(traced.terms[:, :20], traced.row[:, :20], traced.hits)
    assert not build_visibility_cache(direction[:, :20].contiguous(), few, index, WIDTH).clear.any()


def test_a_tile_heeds_what_its_neighbours_met_and_no_others():
    direction, traced, index = scene()
    far = 64 * WIDTH  # rows of 16 tiles further down
    direction, row = direction.repeat(2, 1, 1), torch.cat([torch.full_like(traced.row, -1), traced.row])
    both = SecondaryRays(traced.terms.repeat(2, 1, 1), row, traced.hits)
    for step, clear in ((4 * WIDTH, False), (far, True)):
        visibility_cache = build_visibility_cache(direction, both, torch.cat([index, index + step]), WIDTH)
        assert clear_of(visibility_cache, (0.9, 0, 0.4)) == clear
    assert build_visibility_cache(direction[:0], SecondaryRays(both.terms[:0], both.row[:0], both.hits), index[:0], WIDTH).tile.numel() == 0
