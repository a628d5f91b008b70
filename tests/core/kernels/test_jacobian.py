# SPDX-License-Identifier: GPL-3.0-or-later
"""Jacobian of views by the light's texels against plain numpy."""

import numpy as np
import pytest
import torch
from irgspp.core.kernels.jacobian import gram, jacobian

TEXELS = 24


def on_tensors(*arguments):
    """Call `jacobian` with tensors that share the memory of the arrays, as on a GPU."""
    convert = lambda a: tuple(map(convert, a)) if isinstance(a, tuple) else torch.from_numpy(a)  # noqa: E731
    return jacobian(*map(convert, arguments)).numpy()


@pytest.mark.parametrize("jacobian", [jacobian, on_tensors], ids=["numba", "tensors"])
def test_rows_and_coupling_are_those_of_plain_sums(jacobian):
    random = np.random.default_rng(0)
    lengths = np.array([3, 0, 1, 5, 2])  # a point may have no view
    start, views = np.concatenate([[0], np.cumsum(lengths)]), lengths.sum()
    point = np.repeat(np.arange(len(lengths)), lengths)
    root_weight, coupling_weight, diffuse, specular = random.random((4, views)).astype(np.float32)
    specular[::2] = 0
    irradiance = random.random((len(lengths), TEXELS), np.float32)
    scaled, rest = random.random((2, views, TEXELS), np.float32)
    rows = np.full((views, TEXELS), np.nan, np.float32)
    coupling = jacobian(start, root_weight, coupling_weight, (diffuse, specular), (irradiance, scaled, rest), rows)
    plain = diffuse[:, None] * irradiance[point] + specular[:, None] * scaled + rest
    np.testing.assert_allclose(rows, root_weight[:, None] * plain, rtol=1e-6)
    expected = np.zeros((len(lengths), TEXELS))
    np.add.at(expected, point, coupling_weight[:, None] * plain.astype(float))
    np.testing.assert_allclose(coupling, expected, rtol=1e-6)
    assert (coupling[1] == 0).all()


@pytest.mark.parametrize(("count", "columns"), [(50, 24), (7, 3), (4, 1), (0, 5)])
def test_gram_matrix_is_that_of_numpy(count, columns):
    rows = np.random.default_rng(columns).normal(size=(count, columns)).astype(np.float32)
    product = gram(torch.from_numpy(rows)).numpy()
    np.testing.assert_allclose(product, rows.T.astype(float) @ rows, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(product, product.T, rtol=1e-5, atol=1e-5)
