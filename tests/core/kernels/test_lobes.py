# SPDX-License-Identifier: GPL-3.0-or-later
"""Specular lobe over fixed directions against the BRDF in float64, for both kernels."""

from functools import partial

import numpy as np
import pytest
import torch
from irgspp.core.kernels import lobes
from irgspp.core.kernels.constants import NARROW, PER_STRATUM
from irgspp.core.kernels.lobes import TracedDirections
from irgspp.core.machine.backend import by_warp
from irgspp.core.shading.brdf import specular_lobe
from irgspp.core.stages.second.solver.light_texels import LightTexels

HEIGHT, SIDE, POINTS = 4, 2, 6
TEXELS = 2 * HEIGHT**2
pytestmark = pytest.mark.usefixtures("engine")
ALPHAS = np.float32([0.0025, 0.04, 0.2, 0.5, 1.0, 0.09])  # of the points


def called(function, *arguments):
    """Call a function with arrays, or with tensors where Warp is in use."""
    if not by_warp(torch.empty(0)):
        return function(*arguments)
    converted = [torch.from_numpy(a) if isinstance(a, np.ndarray) else a for a in arguments]
    converted = [TracedDirections(*map(torch.from_numpy, a)) if isinstance(a, tuple) else a for a in converted]
    return tuple(part.numpy() for part in function(*converted))


lobe_rows, lobe_sums = partial(called, lobes.lobe_rows), partial(called, lobes.lobe_sums)


def unit(rows):
    return (rows / np.linalg.norm(rows, axis=-1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def scene():
    """Views of points in random directions, some exactly along a mirrored direction, partly visible texels, indirect light."""
    random = np.random.default_rng(3)
    normal = unit(random.normal(size=(POINTS, 3)))
    point = np.repeat(np.arange(POINTS), 5)
    view = unit(normal[point] + 0.8 * unit(random.normal(size=(len(point), 3))))
    texels = LightTexels.uniform(HEIGHT)
    direction, angle = texels.directions(SIDE, 0)
    for k in (0, 5, 25):  # the sharpest lobe must be hit, or float32 is not tested
        n, d = normal[point[k]], direction.T[np.argmax(direction.T @ normal[point[k]])]
        view[k] = 2 * (n @ d) * n - d
    visible = random.random((POINTS, len(angle)), np.float32)
    indirect = random.random((POINTS, 3, len(angle)), np.float32)
    return point, view, normal, TracedDirections(direction, angle, visible, indirect), texels.strata(SIDE)


def lobe_parts(view, normal, alpha, direction):
    """Return both parts of the lobe of K views in directions (K, D, 3), times the cosine: (2, K, D) float64."""
    n_l, value, power = specular_lobe(view, normal, alpha, direction)
    value = value * n_l.clamp_min(0)
    return torch.stack([value * (1 - power), value * power])


def reference(point, view, normal, alpha, traced, strata):
    """Return both parts per direction (K, D), float64, weighted by cosine and solid angle; means where the lobe is narrow."""
    direction, angle, strata = (torch.from_numpy(a).double() for a in (*traced[:2], strata))
    view, normal, alpha = (torch.from_numpy(a).double() for a in (view, normal[point], alpha))
    single = lobe_parts(view, normal, alpha, direction.T.expand(len(point), -1, -1))
    inner = strata.transpose(1, 2).reshape(-1, 3)  # the directions of a stratum are adjacent
    mean = lobe_parts(view, normal, alpha, inner.expand(len(point), -1, -1)).unflatten(2, (-1, PER_STRATUM)).mean(3)
    half = torch.nn.functional.normalize(view[:, None] + direction.T, dim=2)
    sine2 = 1 - torch.einsum("kdc,kc->kd", half, normal) ** 2
    alpha2 = alpha[:, None] ** 2
    narrow = (sine2 * (1 - alpha2) + alpha2 < NARROW * angle) & (normal @ direction > 0)
    return (torch.where(narrow, mean, single) * angle).numpy()


def close(actual, expected):
    """Assert equality within float32 precision: directions rounded by 1e-7 are 4e-5 of the sharpest lobe's width."""
    assert np.abs(actual - expected).max() < 2e-5 * np.abs(expected).max()
    assert np.abs(actual - expected).sum() < 1e-5 * np.abs(expected).sum()


def test_rows_are_the_brdf_summed_over_each_texel(scene):
    point, view, normal, traced, strata = scene
    f0_term, fresnel_term, f0_indirect, fresnel_indirect = lobe_rows(point, view, normal, ALPHAS, traced, strata, TEXELS)
    parts = reference(point, view, normal, ALPHAS[point], traced, strata)
    for row, rest, part in zip((f0_term, fresnel_term), (f0_indirect, fresnel_indirect), parts, strict=True):
        close(row, (part * traced.visibility[point]).reshape(len(point), SIDE**2, TEXELS).sum(1))
        close(rest, np.einsum("kd,kcd->kc", part, traced.indirect_radiance[point]))
    assert f0_term.max() > 0.1  # in the row of a mirror


@pytest.mark.parametrize("lit", ["light", "indirect light"])
def test_sums_for_several_widths_are_the_brdf_under_a_light(scene, lit):
    point, view, normal, traced, strata = scene
    name = "indirect_radiance" if lit == "light" else "visibility"
    traced = traced._replace(**{name: 0 * getattr(traced, name)})
    light = np.random.default_rng(5).random((TEXELS, 3)).astype(np.float32)
    f0_term, fresnel_term = lobe_sums(point, view, normal, ALPHAS, traced, strata, light)
    incoming = traced.visibility[:, None] * np.tile(light.T, SIDE**2) + traced.indirect_radiance
    for j, alpha in enumerate(ALPHAS):
        parts = reference(point, view, normal, np.full(len(point), alpha), traced, strata)
        for actual, part in zip((f0_term[:, j], fresnel_term[:, j]), parts, strict=True):
            close(actual, np.einsum("kd,kcd->kc", part, incoming[point]))


def test_rows_times_light_are_the_sums(scene):
    point, view, normal, traced, strata = scene
    light = np.random.default_rng(6).random((TEXELS, 3)).astype(np.float32)
    rows = lobe_rows(point, view, normal, ALPHAS, traced, strata, TEXELS)
    sums = lobe_sums(point, view, normal, ALPHAS, traced, strata, light)
    for row, rest, total in zip(rows[:2], rows[2:], sums, strict=True):
        own = total[np.arange(len(point)), point]  # point p has width p
        np.testing.assert_allclose(row @ light + rest, own, rtol=2e-5, atol=1e-7)


def test_a_row_of_light_below_the_horizon_is_empty(scene):
    point, view, normal, traced, strata = scene
    below = (traced.direction.T @ normal.T < 0).reshape(SIDE**2, TEXELS, POINTS).all(0).T
    rows = lobe_rows(point, view, normal, ALPHAS, traced, strata, TEXELS)
    assert below[point].any()
    for row in rows[:2]:
        assert (row[below[point]] == 0).all() and (row >= 0).all()


def test_views_are_independent(scene):
    point, view, normal, traced, strata = scene
    whole = lobe_rows(point, view, normal, ALPHAS, traced, strata, TEXELS)
    chosen = np.array([28, 3, 11])
    for all_of_it, part in zip(whole, lobe_rows(point[chosen], view[chosen], normal, ALPHAS, traced, strata, TEXELS), strict=True):
        assert np.array_equal(all_of_it[chosen], part)
    assert lobe_rows(point[:0], view[:0], normal, ALPHAS, traced, strata, TEXELS)[0].shape == (0, TEXELS)


def test_texels_must_be_a_multiple_of_8(scene):
    point, view, normal, traced, strata = scene
    with pytest.raises(ValueError, match="multiple of 8"):
        lobe_rows(point, view, normal, ALPHAS, traced, strata, 50)
    with pytest.raises(ValueError, match="multiple of 8"):
        lobe_sums(point, view, normal, ALPHAS, traced, strata, np.ones((24, 3), np.float32))


def test_more_widths_than_bits_are_refused(scene):
    point, view, normal, traced, strata = scene
    with pytest.raises(ValueError, match="at most 63"):
        lobe_sums(point, view, normal, np.full(64, 0.5, np.float32), traced, strata, np.ones((24, 3), np.float32))


def test_few_directions_integrate_a_narrow_lobe(scene):
    """Under a light of equal texels, sums of narrow lobes are those of 64 times as many directions to a few per cent."""
    point, view, normal, _, _ = scene
    texels, widths = LightTexels.uniform(16), np.float32([0.02, 0.04, 0.09, 0.16])
    light = np.random.default_rng(7).random((texels.count, 3)).astype(np.float32) ** 4
    sums = []
    for side in (2, 16):
        direction, angle = texels.directions(side, 0)
        seen, dark = np.ones((POINTS, len(angle)), np.float32), np.zeros((POINTS, 3, len(angle)), np.float32)
        traced = TracedDirections(direction, angle, seen, dark)
        sums.append(lobe_sums(point, view, normal, widths, traced, texels.strata(side), light)[0])
    few, many = sums
    error = np.sqrt(np.square(few - many).mean((0, 2)) / np.square(many).mean((0, 2)))
    assert (error < 0.06).all(), error
