# SPDX-License-Identifier: GPL-3.0-or-later
"""Specular lobe over fixed directions against the BRDF in float64, for both kernels."""

from functools import partial

import numpy as np
import pytest
import torch
from irgspp.core.kernels import lobes
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
    converted = [tuple(map(torch.from_numpy, a)) if isinstance(a, tuple) else a for a in converted]
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
    direction, angle = LightTexels.uniform(HEIGHT).directions(SIDE, 0)
    for k in (0, 5, 25):  # the sharpest lobe must be hit, or float32 is not tested
        n, d = normal[point[k]], direction.T[np.argmax(direction.T @ normal[point[k]])]
        view[k] = 2 * (n @ d) * n - d
    visible = random.random((POINTS, len(angle)), np.float32)
    indirect = random.random((POINTS, 3, len(angle)), np.float32)
    return point, view, normal, (direction, angle, visible, indirect)


def reference(point, view, normal, alpha, fixed):
    """Return both parts per direction (K, D), float64, weighted by cosine and solid angle."""
    direction, angle = (torch.from_numpy(a).double() for a in fixed[:2])
    view, normal, alpha = (torch.from_numpy(a).double() for a in (view, normal[point], alpha))
    n_l, value, power = specular_lobe(view, normal, alpha, direction.T.expand(len(point), -1, -1))
    value = (value * n_l.clamp_min(0) * angle).numpy()
    return value * (1 - power.numpy()), value * power.numpy()


def close(actual, expected):
    """Assert equality within float32 precision of the largest element."""
    assert np.abs(actual - expected).max() < 2e-5 * np.abs(expected).max()
    assert np.abs(actual - expected).sum() < 2e-6 * np.abs(expected).sum()


def test_rows_are_the_brdf_summed_over_each_texel(scene):
    point, view, normal, fixed = scene
    scaled, added, rest_scaled, rest_added = lobe_rows(point, view, normal, ALPHAS, fixed, TEXELS)
    parts = reference(point, view, normal, ALPHAS[point], fixed)
    for row, rest, part in zip((scaled, added), (rest_scaled, rest_added), parts, strict=True):
        close(row, (part * fixed[2][point]).reshape(len(point), SIDE**2, TEXELS).sum(1))
        close(rest, np.einsum("kd,kcd->kc", part, fixed[3][point]))
    assert scaled.max() > 0.1  # in the row of a mirror


@pytest.mark.parametrize("lit", ["light", "indirect light"])
def test_sums_for_several_widths_are_the_brdf_under_a_light(scene, lit):
    point, view, normal, (direction, angle, visible, indirect) = scene
    visible, indirect = (visible, 0 * indirect) if lit == "light" else (0 * visible, indirect)
    light = np.random.default_rng(5).random((TEXELS, 3)).astype(np.float32)
    scaled, added = lobe_sums(point, view, normal, ALPHAS, (direction, angle, visible, indirect), light)
    incoming = visible[:, None] * np.tile(light.T, SIDE**2) + indirect
    for j, alpha in enumerate(ALPHAS):
        parts = reference(point, view, normal, np.full(len(point), alpha), (direction, angle))
        for actual, part in zip((scaled[:, j], added[:, j]), parts, strict=True):
            close(actual, np.einsum("kd,kcd->kc", part, incoming[point]))


def test_rows_times_light_are_the_sums(scene):
    point, view, normal, fixed = scene
    light = np.random.default_rng(6).random((TEXELS, 3)).astype(np.float32)
    rows = lobe_rows(point, view, normal, ALPHAS, fixed, TEXELS)
    sums = lobe_sums(point, view, normal, ALPHAS, fixed, light)
    for row, rest, total in zip(rows[:2], rows[2:], sums, strict=True):
        own = total[np.arange(len(point)), point]  # point p has width p
        np.testing.assert_allclose(row @ light + rest, own, rtol=2e-5, atol=1e-7)


def test_a_row_of_light_below_the_horizon_is_empty(scene):
    point, view, normal, fixed = scene
    below = (fixed[0].T @ normal.T < 0).reshape(SIDE**2, TEXELS, POINTS).all(0).T
    rows = lobe_rows(point, view, normal, ALPHAS, fixed, TEXELS)
    assert below[point].any()
    for row in rows[:2]:
        assert (row[below[point]] == 0).all() and (row >= 0).all()


def test_views_are_independent(scene):
    point, view, normal, fixed = scene
    whole = lobe_rows(point, view, normal, ALPHAS, fixed, TEXELS)
    chosen = np.array([28, 3, 11])
    for all_of_it, part in zip(whole, lobe_rows(point[chosen], view[chosen], normal, ALPHAS, fixed, TEXELS), strict=True):
        assert np.array_equal(all_of_it[chosen], part)
    assert lobe_rows(point[:0], view[:0], normal, ALPHAS, fixed, TEXELS)[0].shape == (0, TEXELS)


def test_texels_must_be_a_multiple_of_8(scene):
    point, view, normal, fixed = scene
    with pytest.raises(ValueError, match="multiple of 8"):
        lobe_rows(point, view, normal, ALPHAS, fixed, 50)
    with pytest.raises(ValueError, match="multiple of 8"):
        lobe_sums(point, view, normal, ALPHAS, fixed, np.ones((24, 3), np.float32))
