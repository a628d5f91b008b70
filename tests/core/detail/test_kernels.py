# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels against their definitions in float64."""

from dataclasses import replace

import detail_reference as reference
import numpy as np
import pytest
from irgspp.core.datasets.parsed_dataset import Lens
from irgspp.core.detail.candidates import Candidates, TexelView, add_candidates
from irgspp.core.detail.combination import combine
from irgspp.core.detail.mesh_depth import render_mesh_depth
from irgspp.core.detail.radiometric_correction import RadiometricCorrection
from irgspp.core.detail.texel_sampling import CODES
from irgspp.core.detail.vertex_shading import ViewShading

LENSES = {
    "pinhole": {},
    "polynomial": {"distortion": (-0.15, 0.05, 0.004, -0.003, 0.01)},
    "fisheye": {"distortion": (0.05, -0.02, 0.01, 0.002), "fisheye": True},
}


def test_depth_maps_show_the_nearest_triangle(written):
    camera = written.cameras()["r_1"].resized(40, 40)
    view = render_mesh_depth(written.mesh.vertices, written.mesh.faces, camera)
    triangle, inverse = reference.nearest_triangles(written.mesh.vertices, written.mesh.faces, camera)
    assert ((view.triangle >= 0) == (triangle >= 0)).mean() > 0.995
    both = (view.triangle >= 0) & (triangle >= 0)
    assert (view.triangle == triangle)[both].mean() > 0.98  # ties at edges
    assert np.abs(view.inverse - inverse)[both].max() < 1e-4


def test_values_are_interpolated_with_perspective(written):
    camera = written.cameras()["r_4"]
    view = render_mesh_depth(written.mesh.vertices, written.mesh.faces, camera)
    row, column = np.nonzero(view.triangle >= 0)
    points = view.interpolate(written.mesh.vertices.astype(np.float64), written.mesh.faces, row, column)
    pixel, depth = camera.project(points)
    assert np.abs(pixel - np.stack([column, row], -1) - 0.5).max() < 1e-3
    assert np.abs(1 / depth - view.inverse[row, column]).max() < 1e-5


@pytest.mark.parametrize("model", LENSES)
def test_samples_equal_the_definition(written, model):
    random = np.random.default_rng(1)
    decoded = written.photographs()[3].load()
    lens = replace(decoded.lens, **LENSES[model])
    assert isinstance(lens, Lens)
    decoded = replace(decoded, lens=lens)
    texels, count = written.texels(200), len(written.mesh.vertices)
    size = decoded.camera.height, decoded.camera.width
    correction = RadiometricCorrection(
        np.array([1.1, 0.9, 1.2]), random.uniform(0.8, 1.2, (*size, 3)).astype(np.float32), random.random(size).astype(np.float32)
    )
    shading = ViewShading(*(random.uniform(low, high, (count, 3)).astype(np.float32) for low, high in ((0.1, 1), (0, 0.05))))
    depth = render_mesh_depth(written.mesh.vertices, written.mesh.faces, decoded.camera.resized(160, 160))
    shift = random.uniform(-1, 1, (*size, 2)).astype(np.float32)
    view = TexelView(decoded, depth, correction, shading, 1.5, shift)
    found = Candidates.empty(len(texels.index), 1)
    add_candidates(view, written.mesh, texels, found)
    albedo, weight = reference.texel_samples(view, written.mesh, texels)
    same = (found.weight[:, 0] > 0) == (weight > 0)
    assert same.mean() > 0.998 and (weight > 0).mean() > 0.2  # rounding decides at the edge of visibility
    both = (found.weight[:, 0] > 0) & (weight > 0)
    assert np.quantile(np.abs(found.colour[both, 0] / CODES - albedo[both]), 0.999) < 2e-3
    assert np.quantile(np.abs(found.weight[both, 0] / weight[both] - 1), 0.999) < 2e-3


def candidates(count, kept=6, seed=0):
    random = np.random.default_rng(seed)
    colour = random.integers(0, 40000, (count, kept, 3)).astype(np.uint16)
    weight = random.exponential(1, (count, kept)).astype(np.float32)
    weight[random.random((count, kept)) < 0.3] = 0
    weight[0] = 0
    return Candidates(colour, weight, np.ones(count, np.float32))


@pytest.mark.parametrize("power", [1.0, 2.0, 8.0])
def test_combination_equals_the_definition(power):
    given = candidates(500)
    assert np.allclose(combine(given, power, 0.15), reference.combined(given, power, 0.15), atol=1e-5)


def test_an_outlier_hardly_counts():
    colour, weight = np.full((1, 6, 3), 0.4 * CODES), np.ones((1, 6))
    colour[0, 2] = 1.9 * CODES  # a highlight, and the best photograph
    weight[0, 2] = 1.5
    given = Candidates(colour.astype(np.uint16), weight.astype(np.float32), np.ones(1, np.float32))
    assert np.abs(combine(given) - 0.4).max() < 0.05


def test_the_best_candidates_are_kept(written):
    decoded = written.photographs()[3].load()
    texels, count = written.texels(64), len(written.mesh.vertices)
    size = decoded.camera.height, decoded.camera.width
    shading = ViewShading(np.ones((count, 3), np.float32), np.zeros((count, 3), np.float32))
    depth = render_mesh_depth(written.mesh.vertices, written.mesh.faces, decoded.camera)
    found = Candidates.empty(len(texels.index), 2)
    for factor, blur in ((0.5, 3.0), (0.6, 1.0), (0.7, 2.0)):
        correction = RadiometricCorrection(np.ones(3), np.full((*size, 3), factor, np.float32), np.ones(size, np.float32))
        add_candidates(TexelView(decoded, depth, correction, shading, blur), written.mesh, texels, found)
    seen = np.flatnonzero((found.weight > 0).all(1) & (found.colour[..., 1] > 500).all(1))
    ratio = np.sort(found.colour[seen, :, 1].astype(float), 1)
    assert len(seen) > 200 and np.allclose(ratio[:, 0] / ratio[:, 1], 0.6 / 0.7, rtol=0.02)
