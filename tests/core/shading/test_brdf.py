# SPDX-License-Identifier: GPL-3.0-or-later
"""Microfacet BRDF: integrals of its parts, and the distribution of sampled visible normals."""

import math

import pytest
import torch
from irgspp.core.shading import brdf
from scipy.stats import chi2

F64 = torch.float64


def hemisphere(rows, columns):
    """Midpoint directions (rows, columns, 3) and solid angles (rows, 1), uniform in cos(theta) and phi."""
    z = (torch.arange(rows, dtype=F64) + 0.5) / rows
    phi = (torch.arange(columns, dtype=F64) + 0.5) * (2 * math.pi / columns)
    z, phi = torch.meshgrid(z, phi, indexing="ij")
    s = (1 - z * z).sqrt()
    return torch.stack([s * phi.cos(), s * phi.sin(), z], -1), 2 * math.pi / (rows * columns)


def masking(cosine, alpha):
    """Smith's G1, from the textbook's Lambda (Heitz 2014, eq. 72)."""
    tangent2 = (1 - cosine**2) / cosine**2
    return 1 / (1 + (-1 + (1 + alpha**2 * tangent2).sqrt()) / 2)


def tensor(*values):
    return torch.tensor(values, dtype=F64)


@pytest.mark.parametrize("roughness", [0.3, 0.5, 1.0])
def test_projected_microfacets_cover_the_surface_once(roughness):
    direction, angle = hemisphere(4000, 8)
    alpha = brdf.ggx_alpha(tensor(roughness))
    area = (brdf.ggx_distribution(direction[..., 2], alpha) * direction[..., 2]).sum() * angle
    assert area.item() == pytest.approx(1, rel=2e-3)


def test_roughness_is_squared_and_floored():
    assert brdf.ggx_alpha(tensor(0.5, 0.0, 1.0)).tolist() == pytest.approx([0.25, 0.05**2, 1.0])


def test_visibility_is_correlated_smith_and_reciprocal():
    g = torch.Generator().manual_seed(0)
    n_l, n_v, roughness = (torch.rand(500, generator=g, dtype=F64).clamp_min(0.01) for _ in range(3))
    alpha = brdf.ggx_alpha(roughness)
    lambda_l, lambda_v = 1 / masking(n_l, alpha) - 1, 1 / masking(n_v, alpha) - 1
    expected = 1 / (1 + lambda_l + lambda_v) / (4 * n_l * n_v)
    found = brdf.smith_visibility(n_l, n_v, alpha)
    assert torch.allclose(found, expected, rtol=1e-6)
    assert torch.allclose(found, brdf.smith_visibility(n_v, n_l, alpha), rtol=1e-12)
    assert torch.isfinite(brdf.smith_visibility(tensor(0.0), tensor(0.0), tensor(0.0025))).all()


def fresnel_equations(cosine, index=1.5):
    """Reflectance of unpolarised light at a dielectric."""
    inside = (1 - (1 - cosine**2) / index**2).sqrt()
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return (across**2 + along**2) / 2


def test_fresnel_weight_fits_the_equations_of_a_dielectric():
    cosine = torch.linspace(0, 1, 2001, dtype=F64)
    weight = brdf.fresnel_weight(cosine)
    torch.testing.assert_close(0.04 + 0.96 * weight, fresnel_equations(cosine), rtol=3e-3, atol=0)
    assert weight[0] == pytest.approx(1) and weight[-1] == 0  # exact ends: at grazing angles all is reflected, frontally F0
    assert (weight.diff() <= 0).all()


def test_base_reflectance_of_plastic_and_metal():
    albedo = tensor(0.9, 0.5, 0.1)
    assert brdf.base_reflectance(albedo, tensor(0.0)).tolist() == pytest.approx([0.04] * 3)
    assert torch.equal(brdf.base_reflectance(albedo, tensor(1.0)), albedo)


def visible_density(half, view, alpha):
    """G1(v) D(h) max(v.h, 0) / v.z."""
    v_h = (half * view).sum(-1).clamp_min(0)
    return masking(view[2], alpha) * brdf.ggx_distribution(half[..., 2], alpha) * v_h / view[2]


@pytest.mark.parametrize(("roughness", "n_v"), [(0.4, 0.95), (0.7, 0.4), (1.0, 0.7)])
def test_visible_normals_follow_their_density(roughness, n_v):
    count, rows, columns, fine = 200_000, 6, 8, 120
    alpha = brdf.ggx_alpha(tensor(roughness))[0]
    view = tensor(math.sqrt(1 - n_v**2) * math.cos(0.4), math.sqrt(1 - n_v**2) * math.sin(0.4), n_v)
    u = torch.rand(count, 2, generator=torch.Generator().manual_seed(2), dtype=F64)
    half = brdf.sample_visible_normal(view.expand(count, 3), alpha.expand(count), u)
    assert torch.allclose(half.norm(dim=-1), torch.ones(count, dtype=F64)) and half[:, 2].min() >= 0

    direction, angle = hemisphere(rows * fine, columns * fine)
    cells = (visible_density(direction, view, alpha) * angle).reshape(rows, fine, columns, fine).sum((1, 3))
    assert cells.sum().item() == pytest.approx(1, abs=5e-3)
    phi = torch.atan2(half[:, 1], half[:, 0]) % (2 * math.pi)
    row = (half[:, 2] * rows).long().clamp_max(rows - 1)
    column = (phi / (2 * math.pi) * columns).long().clamp_max(columns - 1)
    observed = torch.bincount(row * columns + column, minlength=rows * columns).double()
    expected = (count * cells / cells.sum()).reshape(-1)
    big = expected > 20
    statistic = ((observed - expected) ** 2 / expected)[big].sum().item()
    assert statistic < chi2.ppf(1 - 1e-4, int(big.sum()) - 1)
    assert observed[~big].sum() < expected[~big].sum() + 40


def test_straight_view_has_a_frame():
    view = tensor(0.0, 0.0, 1.0).expand(1000, 3)
    u = torch.rand(1000, 2, generator=torch.Generator().manual_seed(0), dtype=F64)
    half = brdf.sample_visible_normal(view, torch.full((1000,), 0.3, dtype=F64), u)
    assert torch.isfinite(half).all() and half.mean(0)[:2].norm() < 0.03


@pytest.mark.parametrize("roughness", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("n_v", [0.2, 0.9])
def test_white_metal_never_gives_more_than_it_got(roughness, n_v):
    count = 20_000
    alpha = brdf.ggx_alpha(tensor(roughness)).expand(count)
    view = tensor(math.sqrt(1 - n_v**2), 0, n_v).expand(count, 3)
    u = torch.rand(count, 2, generator=torch.Generator().manual_seed(1), dtype=F64)
    half = brdf.sample_visible_normal(view, alpha, u)
    n_l = 2 * (view * half).sum(-1) * half[:, 2] - view[:, 2]
    lit = n_l > 1e-6
    weight = brdf.smith_visibility(n_l[lit], view[lit, 2], alpha[lit]) * 4 * n_l[lit] * n_v / masking(view[lit, 2], alpha[lit])
    albedo = weight.sum().item() / count
    assert albedo <= 1 + 1e-9
    assert albedo > {0.1: 0.95, 0.5: 0.8, 1.0: 0.3}[roughness]


def irgs_specular(roughness, light, view):
    """The specular part of IRGS' BRDF for one direction, written out."""
    half = [a + b for a, b in zip(light, view, strict=True)]
    half = [c / math.hypot(*half) for c in half]
    v_h, k = sum(a * b for a, b in zip(half, view, strict=True)), (roughness + 1) ** 2 / 8
    fresnel = 0.04 + 0.96 * 2 ** ((-5.55473 * v_h - 6.98316) * v_h)
    peak = half[2] ** 2 * (roughness**4 - 1) + 1
    masks = (view[2] * (1 - k) + k) * (light[2] * (1 - k) + k)
    return fresnel * roughness**4 / min(max(4 * math.pi * peak**2 * masks, 1e-6), 4 * math.pi)


@pytest.mark.parametrize("roughness", [0.02, 0.1, 0.4, 1.0])
@pytest.mark.parametrize("light", [(-0.48, 0.0, 0.877), (0.2, 0.6, 0.775), (0.0, -0.99, 0.141)])
def test_irgs_lobe_is_the_published_formula(roughness, light):
    light, view = (torch.nn.functional.normalize(tensor(*v), dim=0) for v in (light, (0.48, 0.0, 0.877)))
    n_l, value, power = brdf.irgs_lobe(view[None], tensor(0, 0, 1)[None], tensor(roughness), light[None, None])
    assert float(n_l) == pytest.approx(float(light[2]))
    found = float((brdf.DIELECTRIC_F0 + (1 - brdf.DIELECTRIC_F0) * power) * value)
    assert found == pytest.approx(irgs_specular(roughness, light.tolist(), view.tolist()), rel=1e-9)
    below = brdf.irgs_lobe(view[None], tensor(0, 0, 1)[None], tensor(roughness), -light[None, None])
    assert float(below[0]) < 0 and float(below[1]) == 0


@pytest.mark.parametrize(("roughness", "peak"), [(0.1, 4.0), (0.05, 0.25), (0.5, 0.04 / (4 * math.pi * 0.5**4))])
def test_irgs_caps_sharp_lobes(roughness, peak):
    up = tensor(0, 0, 1)[None]
    _, value, power = brdf.irgs_lobe(up, up, tensor(roughness), up[None])
    assert float((0.04 + 0.96 * power) * value) == pytest.approx(peak, rel=1e-2)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 0.9])
def test_irgs_lobe_agrees_with_ours_up_to_the_masking(roughness):
    mirror = torch.nn.functional.normalize(tensor(0.5, 0.0, 1.0), dim=0)
    view, up = mirror * tensor(-1, 1, 1), tensor(0, 0, 1)
    ours = brdf.specular_lobe(view[None], up[None], brdf.ggx_alpha(tensor(roughness)), mirror[None, None])[1]
    irgs = brdf.irgs_lobe(view[None], up[None], tensor(roughness), mirror[None, None])[1]
    assert float(irgs) == pytest.approx(float(ours), rel=0.25)
