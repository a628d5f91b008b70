# SPDX-License-Identifier: GPL-3.0-or-later
"""The lookups of lat-long maps (numpy for Blender's process, PyTorch, numba, Warp) agree within float32 rounding.

They are separate because Blender's process has no torch, gradients need PyTorch operations, and kernels need scalar code. Only within half
a row of the poles they differ on purpose: numpy wraps the rows as Cycles does, the others clamp them.
"""

import numpy as np
import pytest
import torch
from irgspp.core.kernels.cpu import gathering
from irgspp.core.kernels.cpu.directions import lightmap_place, texel_at
from irgspp.core.kernels.cpu.jit import kernel
from irgspp.core.machine.backend import warp_on_cpu
from irgspp.core.scene import environment_map
from irgspp.core.shading import environment_lookup

HEIGHT, WIDTH = 32, 64
TEXELS = np.random.default_rng(0).random((HEIGHT, WIDTH, 3), np.float32)


def directions() -> np.ndarray:
    """Unit float32 directions (N, 3): random ones, and ones on both sides of the seam at u = 0 and 1."""
    rng = np.random.default_rng(1)
    random, seam = rng.normal(size=(4000, 3)), rng.normal(size=(400, 3)) * [0.0, 1e-3, 1.0] - [1.0, 0.0, 0.0]
    all_of_them = np.concatenate([random, seam])
    return (all_of_them / np.linalg.norm(all_of_them, axis=1, keepdims=True)).astype(np.float32)


@kernel
def look_up(begin, end, texels, height, width, direction, out):
    """Write to `out` (N, 3) the radiance in the directions (N, 3), of flat texels."""
    lanes = np.zeros(8, np.float32)
    for i in range(begin, end):
        u, v = lightmap_place(float(direction[i, 0]), float(direction[i, 1]), float(direction[i, 2]))
        pair = gathering._bilinear(texels, 0, height, width, np.float32(u), np.float32(v))
        out[i, 0], out[i, 1], out[i, 2] = gathering._channels(pair, lanes)


def by_numba(direction: np.ndarray) -> np.ndarray:
    """Radiance (N, 3) as the kernels look it up."""
    out = np.empty_like(direction)
    look_up(0, len(direction), TEXELS.reshape(-1), HEIGHT, WIDTH, direction, out)
    return out


def test_texel_directions_are_the_same():
    expected = environment_map.texel_directions(HEIGHT)
    exact = environment_lookup.texel_directions(HEIGHT, WIDTH, torch.float64).numpy()
    np.testing.assert_allclose(exact, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(environment_lookup.texel_directions(HEIGHT, WIDTH).numpy(), expected, rtol=0, atol=1e-6)
    found = [texel_at(*lightmap_place(*d), HEIGHT, WIDTH) for d in expected.reshape(-1, 3)]
    assert found == list(range(HEIGHT * WIDTH))


def test_coordinates_are_the_same():
    direction = directions()
    expected = np.array([lightmap_place(*(float(c) for c in d)) for d in direction])
    found = torch.stack(environment_lookup.direction_to_uv(torch.from_numpy(direction)), 1).numpy()
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6)
    pytest.importorskip("warp")
    with warp_on_cpu():
        by_warp = torch.stack(environment_lookup.direction_to_uv(torch.from_numpy(direction)), 1).numpy()
    np.testing.assert_allclose(by_warp, expected, rtol=0, atol=2e-6)


def test_bilinear_lookups_are_the_same_away_from_the_poles():
    direction = directions()
    row = np.arccos(direction[:, 2].astype(np.float64).clip(-1, 1)) / np.pi * HEIGHT
    between_centres = (row > 0.51) & (row < HEIGHT - 0.51)
    assert between_centres.mean() > 0.99
    numpy = environment_map.EnvironmentMap(TEXELS).radiance(direction)
    pytorch = environment_lookup.lookup(torch.from_numpy(TEXELS), torch.from_numpy(direction)).numpy()
    numba = by_numba(direction)
    np.testing.assert_allclose(pytorch, numba, rtol=0, atol=1e-4)
    np.testing.assert_allclose(numpy[between_centres], numba[between_centres], rtol=0, atol=1e-4)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rows_are_clamped_at_the_poles_except_in_numpy(sign):
    pole, middle = np.float32([[0.0, 0.0, sign]]), slice(WIDTH // 2 - 1, WIDTH // 2 + 1)
    nearest, opposite = (TEXELS[row, middle].mean(0) for row in ((0, -1) if sign > 0 else (-1, 0)))
    pytorch = environment_lookup.lookup(torch.from_numpy(TEXELS), torch.from_numpy(pole)).numpy()
    np.testing.assert_allclose(by_numba(pole)[0], nearest, atol=1e-5)
    np.testing.assert_allclose(pytorch[0], nearest, atol=1e-5)
    np.testing.assert_allclose(environment_map.EnvironmentMap(TEXELS).radiance(pole)[0], (nearest + opposite) / 2, atol=1e-5)
