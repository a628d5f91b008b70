# SPDX-License-Identifier: GPL-3.0-or-later
"""Coverage of the pixels at a slanted edge."""

import numpy as np
from irgspp.core.capture.soft_edges import guided_filter, soft_edges


def slanted(size: int = 48, parts: int = 8) -> np.ndarray:
    """Coverage of a half plane, (size, size)."""
    y, x = (np.mgrid[: size * parts, : size * parts] + 0.5) / parts
    return (x + 0.4 * y > 0.7 * size).astype(np.float32).reshape(size, parts, size, parts).mean((1, 3))


def test_coverage_is_nearer_than_the_binary_mask():
    truth = slanted()
    colour = np.repeat((0.2 + 0.6 * truth)[..., None], 3, -1)
    soft = soft_edges(colour, (truth >= 0.5).astype(np.float32))
    edge = (truth > 0) & (truth < 1)
    assert np.abs(soft - truth)[edge].mean() < 0.6 * np.abs((truth >= 0.5) - truth)[edge].mean()
    assert ((soft >= 0.5) == (truth >= 0.5)).mean() > 0.99


def test_pixels_away_from_the_edge_stay_binary():
    truth = slanted()
    soft = soft_edges(np.random.default_rng(0).random((48, 48, 3)).astype(np.float32), truth)
    assert set(np.unique(soft[:, :8])) == {0.0}
    assert set(np.unique(soft[:, -8:])) == {1.0}


def test_filter_of_a_flat_guide_is_an_average():
    image = np.random.default_rng(0).random((20, 20)).astype(np.float32)
    filtered = guided_filter(np.full_like(image, 0.3), image, 1, 1e-3)
    inner = image[8:13, 8:13].copy()  # the average of averages is taken over 5 x 5 pixels with weights 1 2 3 2 1
    weight = np.outer([1, 2, 3, 2, 1], [1, 2, 3, 2, 1]) / 81
    assert np.isclose(filtered[10, 10], (weight * inner).sum(), atol=1e-4)
