# SPDX-License-Identifier: GPL-3.0-or-later
"""Densities integrate to one, samples follow them, and the mixture combines those of the strategies."""

import math

import pytest
import torch
from irgspp.core.shading.sampling import LightDistribution, draw, orthonormal_basis, point_set
from sampling_checks import F64, LIGHT_MAPS, NORMAL, assert_follows, local_frame, one_sample_each, tilted_view, unit

# --- visible normals

SLOPES = (12, 16, 32)  # cells in radius and azimuth, and points per cell along either


def slope_cell(half, alpha):
    """Cell of (..., 3) local half vectors in the plane of slopes, and its two coordinates in 0..1.

    Radius s = alpha sqrt(u / (1 - u)), u = 1 - (1 - t)^2: uniform cells in t and azimuth are good for a lobe of any sharpness.
    """
    r2 = (half[..., 0] ** 2 + half[..., 1] ** 2) / (half[..., 2] * alpha) ** 2
    t = 1 - (1 / (1 + r2)).sqrt()
    phi = torch.atan2(half[..., 1], half[..., 0]) / (2 * math.pi) % 1
    return (t * SLOPES[0]).long().clamp_max(SLOPES[0] - 1) * SLOPES[1] + (phi * SLOPES[1]).long().clamp_max(SLOPES[1] - 1)


def slope_grid(alpha):
    """Half vectors (K, 3) in the middle of fine cells, and d omega_h of each."""
    rows, columns, fine = SLOPES
    t = (torch.arange(rows * fine, dtype=F64) + 0.5) / (rows * fine)
    phi = (torch.arange(columns * fine, dtype=F64) + 0.5) * (2 * math.pi / (columns * fine))
    t, phi = torch.meshgrid(t, phi, indexing="ij")
    u = 1 - (1 - t) ** 2
    s = alpha * (u / (1 - u)).sqrt()
    half = torch.nn.functional.normalize(torch.stack([s * phi.cos(), s * phi.sin(), torch.ones_like(s)], -1), dim=-1)
    slope_area = alpha**2 / (2 * (1 - u) ** 2) * 2 * (1 - t) * (2 * math.pi) / (rows * columns * fine**2)
    return half.reshape(-1, 3), (slope_area * half[..., 2] ** 3).reshape(-1)


def textbook_ggx(view, half, alpha):
    """G1(v) D(h) / (4 n.v) of local vectors (Heitz 2018, with Lambda of Heitz 2014): the density of the mirrored direction."""
    cosine2 = half[..., 2] ** 2
    tangent2 = (half[..., 0] ** 2 + half[..., 1] ** 2) / cosine2
    distribution = 1 / (math.pi * alpha**2 * cosine2**2 * (1 + tangent2 / alpha**2) ** 2)
    grazing2 = (1 - view[..., 2] ** 2) / view[..., 2] ** 2
    g1 = 1 / (1 + (-1 + (1 + alpha**2 * grazing2).sqrt()) / 2)
    return g1 * distribution / (4 * view[..., 2])


@pytest.mark.parametrize("degrees", [0, 45, 80, 88])
@pytest.mark.parametrize("roughness", [0.03, 0.1, 0.3, 0.6, 1.0])
def test_mirrored_visible_normals_follow_their_density(roughness, degrees):
    alpha = max(roughness, 0.05) ** 2
    view, frame = tilted_view(degrees), local_frame()
    direction, density = one_sample_each(view, NORMAL, roughness, (0, 1, 0), LightDistribution(torch.ones(2, 4, 3)))
    half = torch.nn.functional.normalize(direction + view, dim=-1) @ frame
    view = view @ frame

    expected_density = textbook_ggx(view, half, alpha)
    assert ((density - expected_density).abs() < 5e-3 * expected_density).double().mean() > 0.999

    grid, angle = slope_grid(alpha)
    v_h = (grid @ view).clamp_min(0)
    mass = textbook_ggx(view, grid, alpha) * 4 * v_h * angle  # d omega = 4 v.h d omega_h
    probability = torch.zeros(SLOPES[0] * SLOPES[1], dtype=F64).index_add(0, slope_cell(grid, alpha), mass)
    assert probability.sum().item() == pytest.approx(1, abs=2e-3)
    assert_follows(slope_cell(half, alpha), probability / probability.sum())


# --- the hemisphere


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1e-4, 0.0, -1.0), (-0.6, 0.5, -0.4)])
def test_cosine_samples_follow_their_density(normal):
    normal = unit(*normal)
    direction, density = one_sample_each(normal, normal, 0.5, (1, 0, 0), LightDistribution(torch.ones(2, 4, 3)))
    local = direction @ local_frame(normal)
    assert torch.allclose(density, local[:, 2] / math.pi, atol=1e-6)
    phi = torch.atan2(local[:, 1], local[:, 0]) / (2 * math.pi) % 1
    cells = (local[:, 2] ** 2 * 12).long().clamp(0, 11) * 16 + (phi * 16).long().clamp_max(15)
    assert_follows(cells, torch.full((192,), 1 / 192, dtype=F64))


def test_strata_cover_the_hemisphere_uniformly():
    points, count = 4000, 16
    normal = NORMAL.expand(points, 3)
    light = LightDistribution(torch.ones(2, 4, 3))
    samples = draw(normal, normal, torch.ones(points, dtype=F64), (8, 4, 4), light, torch.Generator().manual_seed(0), "stratified")
    assert torch.allclose(samples.density, torch.full((points, count), 0.5 / math.pi, dtype=F64))
    local = samples.direction @ local_frame()
    strata = (local[..., 2] * count).sort(1).values  # one in each, up to the point's own shift
    assert (strata.diff(dim=1) - 1).abs().max() < 1e-6
    first = local[:, 0]
    phi = torch.atan2(first[:, 1], first[:, 0]) / (2 * math.pi) % 1
    cells = (first[:, 2] * 6).long().clamp(0, 5) * 8 + (phi * 8).long().clamp_max(7)
    assert_follows(cells, torch.full((48,), 1 / 48, dtype=F64))


@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_local_frames_are_orthonormal_everywhere(dtype):
    g = torch.Generator().manual_seed(0)
    random = torch.randn(2000, 3, generator=g, dtype=dtype)
    poles = torch.tensor([[0, 0, 1], [0, 0, -1], [1e-8, 0, -1], [0, -1e-4, -1], [1, 0, 0], [0, 1, -1e-9], [0, 1, 0.0]], dtype=dtype)
    normal = torch.nn.functional.normalize(torch.cat([random, poles]), dim=-1)
    frame = orthonormal_basis(normal)
    eye = torch.eye(3, dtype=dtype).expand_as(frame)
    assert (frame.mT @ frame - eye).abs().max() < 1e3 * torch.finfo(dtype).eps
    assert torch.linalg.det(frame).min() > 0.99
    assert torch.equal(frame[..., 2], normal)


# --- the mixture


def test_the_density_is_that_of_the_mixture():
    g = torch.Generator().manual_seed(3)
    points, counts = 300, (5, 3, 4)
    normal = torch.nn.functional.normalize(torch.randn(points, 3, generator=g, dtype=F64), dim=-1)
    view = torch.nn.functional.normalize(normal + 0.6 * torch.randn(points, 3, generator=g, dtype=F64), dim=-1)
    view = torch.where((view * normal).sum(-1, keepdim=True) < 0.05, normal, view)
    roughness = torch.rand(points, generator=g, dtype=F64)
    light = LightDistribution(LIGHT_MAPS["random"].double())
    samples = draw(view, normal, roughness, counts, light, g)

    cosine = torch.einsum("pnc,pc->pn", samples.direction, normal)
    half = torch.nn.functional.normalize(samples.direction + view[:, None], dim=-1)
    n_h, n_v = torch.einsum("pnc,pc->pn", half, normal), (view * normal).sum(-1)[:, None]
    planar = lambda z: torch.stack([(1 - z * z).clamp_min(0).sqrt(), torch.zeros_like(z), z], -1)  # noqa: E731
    alpha = roughness.clamp_min(0.05).square()[:, None]
    ggx = torch.where(n_h > 0, textbook_ggx(planar(n_v), planar(n_h), alpha), 0.0)
    expected = (5 * cosine.clamp_min(0) / math.pi + 3 * ggx + 4 * light.density(samples.direction)) / 12
    assert torch.allclose(samples.density, expected, rtol=1e-6)
    assert samples.direction.norm(dim=-1).sub(1).abs().max() < 1e-12


def scene(points=500, dtype=torch.float32):
    g = torch.Generator().manual_seed(5)
    normal, view = torch.nn.functional.normalize(torch.randn(2, points, 3, generator=g, dtype=dtype), dim=-1)
    return view, normal, torch.rand(points, generator=g, dtype=dtype), (6, 3, 3), LightDistribution(LIGHT_MAPS["random"].to(dtype))


@pytest.mark.parametrize("method", ["mis", "stratified"])
def test_one_seed_one_result(method):
    same, again, other = (draw(*scene(), torch.Generator().manual_seed(s), method) for s in (7, 7, 8))
    assert torch.equal(same.direction, again.direction) and torch.equal(same.density, again.density)
    assert not torch.equal(same.direction, other.direction)
    shift = torch.rand(500, 2, generator=torch.Generator().manual_seed(7))
    assert torch.equal(draw(*scene(), shift, method).direction, same.direction)


@pytest.mark.parametrize("method", ["mis", "stratified"])
@pytest.mark.parametrize("dtype", [torch.float32, F64])
def test_samples_are_plain_tensors_without_history_at_any_view(method, dtype):
    """Half of the views look at the back: silhouettes, where averaged normals turn away."""
    view, normal, roughness, counts, light = scene(dtype=dtype)
    inputs = (view, normal.requires_grad_(), roughness.requires_grad_())
    samples = draw(*inputs, counts, light, torch.rand(500, 2, dtype=dtype), method)
    assert samples.direction.shape == (500, 12, 3) and samples.density.shape == (500, 12)
    for tensor in (samples.direction, samples.density):
        assert tensor.dtype == dtype and tensor.is_contiguous() and not tensor.requires_grad
        assert torch.isfinite(tensor).all()
    assert samples.density.min() > 0
    assert samples.direction.norm(dim=-1).sub(1).abs().max() < 1e-5


@pytest.mark.parametrize("name", LIGHT_MAPS)
def test_the_kernel_agrees_with_its_reference_in_double(name):
    view, normal, roughness, counts, _ = scene()
    single, double = LightDistribution(LIGHT_MAPS[name]), LightDistribution(LIGHT_MAPS[name].double())
    shift = torch.rand(500, 2, generator=torch.Generator().manual_seed(2))
    found = draw(view, normal, roughness, counts, single, shift)
    exact = draw(view.double(), normal.double(), roughness.double(), counts, double, shift.double())
    error = (found.direction.double() - exact.direction).norm(dim=-1)
    assert error.quantile(0.99) < 1e-5
    agree = (found.density.double() - exact.density).abs() < 5e-3 * exact.density
    assert agree.double().mean() > 0.99


def test_what_is_not_a_number_stays_visible_and_where_it_is():
    view, normal, roughness, counts, light = scene(3)
    shift = torch.rand(3, 2)
    sound = draw(view, normal, roughness, counts, light, shift)
    normal[1] = math.nan
    samples = draw(view, normal, roughness, counts, light, shift)
    assert (samples.density[1].isnan() | samples.direction[1].isnan().any(-1)).all()
    for row in (0, 2):
        assert torch.equal(samples.direction[row], sound.direction[row]) and torch.equal(samples.density[row], sound.density[row])


def test_points_are_spread_evenly():
    points = point_set(64)
    assert points.shape == (64, 2) and points.min() >= 0 and points.max() < 1
    assert torch.bincount((points[:, 1] * 64).long(), minlength=64).eq(1).all()
    gap = (points[:, None] - points[None]).abs()
    gap = torch.minimum(gap, 1 - gap).norm(dim=-1) + torch.eye(64)
    assert gap.min() > 0.5 / 8  # at random it would be near 0.01


@pytest.mark.parametrize("counts", [(0, 0, 0), (4, -1, 2)])
def test_counts_must_make_samples(counts):
    view, normal, roughness, _, light = scene(4)
    with pytest.raises(ValueError, match="counts"):
        draw(view, normal, roughness, counts, light, torch.rand(4, 2))


def test_unknown_method_is_refused():
    with pytest.raises(ValueError, match="stratified"):
        draw(*scene(4), torch.rand(4, 2), "random")


def test_no_points_make_no_samples():
    samples = draw(*scene(0), torch.rand(0, 2))
    assert samples.direction.shape == (0, 12, 3)
