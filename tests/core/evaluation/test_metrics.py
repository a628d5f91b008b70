# SPDX-License-Identifier: GPL-3.0-or-later
"""Metrics against values known in advance."""

import numpy as np
import pytest
from irgspp.core.evaluation import metrics
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.scene.mesh import Mesh
from irgspp.core.shading.procedural_lights import sky_light
from skimage.metrics import structural_similarity

RANDOM = np.random.default_rng(0)


def test_psnr_of_a_constant_error():
    a = np.full((4, 5, 3), 0.3)
    assert metrics.psnr(a, a + 0.1) == pytest.approx(20)
    mask = np.zeros((4, 5), bool)
    mask[1, 2] = True
    b = a.copy()
    b[1, 2] += 0.01
    assert metrics.psnr(a, b, mask) == pytest.approx(40)
    assert metrics.psnr(a, a) == 100


def test_images_are_compared_encoded_on_black_and_clipped():
    rgba = np.array([[[0.05, 0.1, 0.15, 0.5], [3.0, 0.0, 0.2, 1.0], [0.0, 0.0, 0.0, 0.0], [np.nan, np.inf, -1.0, 1.0]]])
    expected = np.zeros((1, 4, 3))
    expected[0, 0] = 0.5 * encode_srgb(np.array([0.1, 0.2, 0.3]))
    expected[0, 1] = [1, 0, encode_srgb(np.array(0.2))]
    expected[0, 3] = [0, 1, 0]
    assert np.allclose(metrics.on_black(rgba), expected)


def test_ssim_falls_with_noise():
    a = RANDOM.random((32, 32, 3))
    values = [metrics.ssim(a, np.clip(a + s * RANDOM.normal(size=a.shape), 0, 1)) for s in (0, 0.05, 0.3)]
    assert values[0] == pytest.approx(1) and values[0] > values[1] > values[2]


def test_ssim_equals_that_of_scikit_image():
    a, b = RANDOM.random((20, 31, 3)), RANDOM.random((20, 31, 3))
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0, "channel_axis": -1}
    assert metrics.ssim(a, b) == pytest.approx(structural_similarity(a, b, **options), abs=1e-12)


def test_ssim_of_constant_images_and_of_a_small_window():
    a, b = np.full((13, 15, 3), 0.3), np.full((13, 15, 3), 0.5)
    for window in (3, 11):
        assert metrics.ssim(a, b, window) == pytest.approx((2 * 0.15 + 1e-4) / (0.09 + 0.25 + 1e-4))
    a, b = RANDOM.random((5, 6, 3)), RANDOM.random((5, 6, 3))
    w = np.exp(-np.array([1, 0, 1]) / (2 * 1.5**2))
    w = np.outer(w, w)[..., None] / w.sum() ** 2
    x, y = (np.pad(p, ((1, 1), (1, 1), (0, 0)), mode="reflect") for p in (a, b))
    values = []
    for i, j in np.ndindex(5, 6):
        p, q = x[i : i + 3, j : j + 3], y[i : i + 3, j : j + 3]
        m, n = (w * p).sum((0, 1)), (w * q).sum((0, 1))
        v, u, c = (w * p * p).sum((0, 1)) - m * m, (w * q * q).sum((0, 1)) - n * n, (w * p * q).sum((0, 1)) - m * n
        values.append((2 * m * n + 1e-4) * (2 * c + 9e-4) / ((m * m + n * n + 1e-4) * (v + u + 9e-4)))
    assert metrics.ssim(a, b, 3) == pytest.approx(np.mean(values), abs=1e-12)


def test_a_mask_loses_two_pixels_but_not_at_the_edge_of_the_image():
    mask = np.zeros((12, 14), bool)
    mask[:7, 3:12] = True
    expected = np.zeros_like(mask)
    expected[:5, 5:10] = True
    assert (metrics.eroded(mask) == expected).all()


def test_angles_between_normals():
    axis = RANDOM.normal(size=(6, 7, 3))
    n = np.cross(axis, RANDOM.normal(size=(6, 7, 3)))
    n, axis = n / np.linalg.norm(n, axis=-1, keepdims=True), axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    for degrees in (0.0, 0.01, 30.0, 179.0):
        t = np.radians(degrees)
        turned = n * np.cos(t) + np.cross(axis, n) * np.sin(t)
        assert np.allclose(metrics.normal_angles(turned, n), degrees, atol=1e-5)
    assert (metrics.normal_angles(np.zeros_like(n), n) == 90).all()


def test_albedo_scale_is_found_in_spite_of_outliers():
    truth = [RANDOM.uniform(0.1, 0.9, (8, 9, 3)) for _ in range(2)]
    factor = np.array([0.5, 2.0, 1.25])
    predicted = [t / factor for t in truth]
    predicted[0][:3] = 0  # missed: infinite ratios
    masks = [np.ones((8, 9), bool), np.ones((8, 9), bool)]
    assert np.allclose(metrics.albedo_scale(predicted, truth, masks), factor)


def test_environment_is_compared_up_to_a_scale_per_channel():
    truth = RANDOM.uniform(0, 1, (16, 32, 3))
    tinted = metrics.environment_metrics(truth * np.array([2.0, 0.1, 7.0]), truth)
    assert tinted["environment_psnr"] == pytest.approx(100) and tinted["environment_ssim"] == pytest.approx(1)
    assert tinted["environment_psnr_unscaled"] < 20
    turned = metrics.environment_metrics(np.roll(truth, 5, 1), truth)
    assert turned["environment_psnr"] < 15 and turned["environment_ssim"] < 0.9
    other = metrics.environment_metrics(sky_light(64, 128), sky_light(16, 32))
    assert other["environment_psnr"] > 27  # its own resolution doesn't matter
    assert "environment_ssim" not in metrics.environment_metrics(truth[:4, :8], truth[:4, :8])  # too small for the window


def test_environment_on_a_grid_of_its_own():
    truth = np.repeat(np.repeat(RANDOM.uniform(0, 1, (8, 16, 3)), 4, 0), 4, 1)
    coarse = metrics.environment_metrics(truth * 3, truth, (16, 32))
    assert coarse["environment_psnr"] == pytest.approx(100)
    assert metrics.environment_metrics(truth * 3, truth, (16, 32))["environment_psnr_unscaled"] < 15


def test_part_of_the_environment_has_its_own_scale():
    truth = RANDOM.uniform(0, 1, (16, 32, 3))
    part = np.arange(16)[:, None] < 8 + np.zeros((1, 32))
    light = np.where(part[..., None], 3 * truth, 1 - truth)
    found = metrics.environment_metrics(light, truth, part=part)
    assert found["environment_psnr_constrained"] == pytest.approx(100) and found["environment_psnr"] < 20
    assert "environment_psnr_constrained" not in metrics.environment_metrics(light, truth, part=np.zeros_like(part))


def globe(radius: float, rows: int = 60) -> Mesh:
    """Return a triangulated sphere, open at the poles: close enough for distances."""
    v, u = np.meshgrid(np.linspace(1e-3, np.pi - 1e-3, rows), np.linspace(0, 2 * np.pi, 2 * rows), indexing="ij")
    n = np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], -1).reshape(-1, 3)
    a = (np.arange(rows - 1)[:, None] * 2 * rows + np.arange(2 * rows - 1)).reshape(-1)
    b, c, d = a + 1, a + 2 * rows + 1, a + 2 * rows
    faces = np.concatenate([np.stack([a, d, c], -1), np.stack([a, c, b], -1)]).astype(np.int32)
    grey = np.full(len(n), 0.5, np.float32)
    return Mesh(
        (radius * n).astype(np.float32),
        n.astype(np.float32),
        n[:, :2].astype(np.float32),
        faces,
        np.repeat(grey[:, None], 3, 1),
        grey,
        grey,
    )


def test_mesh_distances_are_those_of_concentric_spheres():
    points = RANDOM.normal(size=(3000, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    measured = metrics.mesh_distances(globe(1.03), points, points, samples=50_000)
    for name in ("mesh_completeness", "mesh_accuracy", "mesh_chamfer"):
        assert measured[name] == pytest.approx(0.03, abs=0.002)
    assert measured["mesh_stray"] < 0.005 and measured["mesh_triangles"] == len(globe(1.03).faces)
    half = points[points[:, 2] > 0]
    assert metrics.mesh_distances(globe(1.03), half, half, samples=50_000)["mesh_stray"] == pytest.approx(0.47, abs=0.04)
    assert metrics.mesh_distances(globe(2.0), points, points, samples=1000)["mesh_stray"] == 1


def test_squared_chamfer_of_spheres_far_apart():
    points = RANDOM.normal(size=(3000, 3))
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    assert metrics.squared_chamfer(globe(3.0), points) == pytest.approx(4, rel=0.01)
