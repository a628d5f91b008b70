# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimator of the rendering equation: unbiased, less noisy than any single strategy, energy conserving, differentiable."""

import math

import pytest
import torch
from irgspp.core.shading.brdf import fresnel_weight, irgs_lobe
from irgspp.core.shading.environment_lookup import lookup, texel_directions
from irgspp.core.shading.rendering_equation import reflect_light
from irgspp.core.shading.sampling import LightDistribution, Samples, draw, orthonormal_basis
from irgspp.core.shading.specular_albedo import specular_albedo
from irgspp.core.shading.split_sum import diffuse_light, shade, specular_light

F64 = torch.float64
ALBEDO, METALLIC = (0.8, 0.5, 0.2), 0.4
MIS = (8, 4, 4)


def unit(vector):
    return torch.nn.functional.normalize(vector, dim=-1)


def soft_light():
    d = texel_directions(32, 64)
    return torch.stack([0.2 + (d @ torch.tensor(axis)).clamp_min(0) ** 4 for axis in ((1.0, 0, 0), (0, 0.8, 0.6), (0, 0, 1.0))], -1)


def hot_light(row, column):
    light = torch.zeros(32, 64, 3)
    light[row, column] = torch.tensor([300.0, 200.0, 100.0])
    return light


LIGHTS = {"soft": soft_light(), "hot seam": hot_light(9, 63), "hot pole": hot_light(0, 3)}
NORMAL = unit(torch.tensor([-0.5, 0.1, 0.9], dtype=F64))


# The brightest directions of the lights are 35, 26 and 27 degrees from the normal, all in other azimuths.
BRIGHTEST = {name: texel_directions(32, 64, F64).reshape(-1, 3)[light.sum(-1).argmax()] for name, light in LIGHTS.items()}


def view_at(degrees, name="soft"):
    """A view at an angle to NORMAL, opposite to where the light is brightest: at some angle the two mirror each other."""
    angle = math.radians(degrees)
    across = unit((BRIGHTEST[name] @ NORMAL) * NORMAL - BRIGHTEST[name])
    return math.cos(angle) * NORMAL + math.sin(angle) * across


def estimates(light, view, roughness, counts=MIS, points=6000, method="mis", albedo=ALBEDO, metallic=METALLIC, conserving=False):
    """Diffuse and specular (points, 3) of independent estimates at like points."""
    single = torch.float32
    view, normal = (t.to(single).expand(points, 3) for t in (view, NORMAL))
    rough = torch.full((points,), roughness)
    samples = draw(view, normal, rough, counts, LightDistribution(light), torch.Generator().manual_seed(1), method)
    incoming = lookup(light, samples.direction.reshape(-1, 3)).view_as(samples.direction)
    materials = (torch.tensor(albedo).expand(points, 3), rough, torch.full((points,), metallic))
    return tuple(t.double() for t in reflect_light(view, normal, *materials, samples, incoming, conserving))


def textbook(light, view, direction, roughness):
    """Diffuse and specular integrand f L cos (K, 3) in float64, of its own but for the Fresnel weight, which test_brdf.py checks."""
    alpha, albedo = max(roughness, 0.05) ** 2, torch.tensor(ALBEDO, dtype=F64)
    n_l, n_v = direction @ NORMAL, view @ NORMAL
    half = unit(direction + view)
    n_h, v_h = half @ NORMAL, half @ view
    tangent2 = torch.linalg.cross(half, NORMAL.expand_as(half)).square().sum(-1) / n_h**2
    d = 1 / (math.pi * alpha**2 * n_h**4 * (1 + tangent2 / alpha**2) ** 2)
    smith = lambda c: (-1 + (1 + alpha**2 * (1 - c**2) / c**2).sqrt()) / 2  # noqa: E731
    g = 1 / (1 + smith(n_l.clamp_min(1e-9)) + smith(n_v))
    f0 = 0.04 * (1 - METALLIC) + METALLIC * albedo
    fresnel = f0 + (1 - f0) * fresnel_weight(v_h)[:, None]
    specular = fresnel * (d * g / (4 * n_l.clamp_min(1e-9) * n_v))[:, None]
    lit = lookup(light.double(), direction) * n_l.clamp_min(0)[:, None]
    return (1 - METALLIC) * albedo / math.pi * lit, specular * lit


def reference(light, view, roughness, count=500_000):
    """Mean and standard error (2, 3) of the reflected light, by sampling strategies of its own."""
    if light.mean() < 0.25 * light.max() and (light > 0).sum() == 3:
        return hot_reference(light, view, roughness)
    u = torch.rand(2, count, 2, generator=torch.Generator().manual_seed(9), dtype=F64)
    frame = orthonormal_basis(NORMAL[None])[0]
    values = []
    for k in range(2):  # uniform over the hemisphere for the diffuse lobe, over D n.h for the specular one
        phi, alpha2 = 2 * math.pi * u[k, :, 1], max(roughness, 0.05) ** 4
        z = u[0, :, 0] if k == 0 else ((1 - u[1, :, 0]) / (1 + (alpha2 - 1) * u[1, :, 0])).sqrt()
        s = (1 - z * z).clamp_min(0).sqrt()
        drawn = torch.stack([s * phi.cos(), s * phi.sin(), z], -1) @ frame.T
        if k == 0:
            values.append(textbook(light, view, drawn, roughness)[0] * 2 * math.pi)
            continue
        v_h = drawn @ view
        direction = 2 * v_h[:, None] * drawn - view
        density = alpha2 / (math.pi * ((z * z) * (alpha2 - 1) + 1) ** 2) * z / (4 * v_h)
        seen = (v_h > 0) & (direction @ NORMAL > 0)
        values.append(torch.where(seen[:, None], textbook(light, view, direction, roughness)[1] / density[:, None], 0.0))
    values = torch.stack(values)
    return values.mean(1), values.std(1) / math.sqrt(count)


def hot_reference(light, view, roughness, fine=300):
    """The same by the midpoint rule over the texels that see the bright one in a bilinear lookup."""
    row, column = (int(i) for i in (light[..., 0] == light[..., 0].max()).nonzero()[0])
    share = (torch.arange(3 * fine, dtype=F64) + 0.5) / fine - 1
    theta = (row + share) * (math.pi / 32)
    theta = theta[theta > 0]
    phi = math.pi - (column + share) * (2 * math.pi / 64)
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    direction = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1).reshape(-1, 3)
    angle = theta.sin().reshape(-1, 1) * (math.pi / 32) * (2 * math.pi / 64) / fine**2
    values = torch.stack([(v * angle).sum(0) for v in textbook(light, view, direction, roughness)])
    return values, 1e-3 * values


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize(("roughness", "degrees"), [(0.03, 27), (0.1, 32), (0.3, 80), (0.6, 45), (1.0, 88)])
def test_estimate_is_unbiased(name, roughness, degrees):
    light, view = LIGHTS[name], view_at(degrees, name)
    expected, uncertain = reference(light, view, roughness)
    found = torch.stack(estimates(light, view, roughness))
    error = (found.std(1) / math.sqrt(found.shape[1])).square() + uncertain.square()
    assert ((found.mean(1) - expected).abs() < 4.5 * error.sqrt() + 1e-6).all()
    assert (found.std(1) / math.sqrt(found.shape[1]) < 0.03 * expected + 1e-3).all()  # or it would say nothing


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_stratified_estimate_is_unbiased(roughness):
    light, view = LIGHTS["soft"], view_at(40)
    expected, uncertain = reference(light, view, roughness)
    found = torch.stack(estimates(light, view, roughness, method="stratified"))
    error = (found.std(1) / math.sqrt(found.shape[1])).square() + uncertain.square()
    assert ((found.mean(1) - expected).abs() < 4.5 * error.sqrt()).all()


@pytest.mark.parametrize(("name", "roughness"), [("soft", 0.1), ("soft", 0.3), ("hot seam", 0.3)])
def test_together_the_strategies_are_of_less_noise_than_each_alone(name, roughness):
    """In what the eye gets, diffuse and specular together."""
    view = view_at(50, name)
    noise = {c: sum(estimates(LIGHTS[name], view, roughness, c)).var(0).sum() for c in (MIS, (16, 0, 0), (0, 16, 0))}
    assert noise[MIS] < 0.5 * min(noise[16, 0, 0], noise[0, 16, 0])
    if name == "soft":  # a hot texel alone is what light-map sampling is perfect for
        assert noise[MIS] < sum(estimates(LIGHTS[name], view, roughness, (0, 0, 16))).var(0).sum()


WHITE = torch.ones(4, 8, 3)


@pytest.mark.parametrize("method", ["mis", "stratified"])
@pytest.mark.parametrize("degrees", [0, 60, 88])
def test_a_diffuse_surface_in_a_white_furnace(method, degrees):
    diffuse, _ = estimates(WHITE, view_at(degrees), 0.5, albedo=(1.0, 0.6, 0.1), metallic=0.0, method=method)
    assert torch.allclose(diffuse.mean(0), torch.tensor([1.0, 0.6, 0.1], dtype=F64), rtol=0.01)


@pytest.mark.parametrize("degrees", [0, 60, 88])
@pytest.mark.parametrize("roughness", [0.03, 0.1, 0.3, 0.6, 1.0])
def test_no_more_light_goes_out_than_came_in(roughness, degrees):
    view = view_at(degrees)
    diffuse, metal = estimates(WHITE, view, roughness, albedo=(1.0, 1.0, 1.0), metallic=1.0)
    assert not diffuse.any()
    assert metal.mean() < 1 + 4 * metal[:, 0].std() / math.sqrt(len(metal))
    table = specular_albedo((view @ NORMAL)[None].float(), torch.tensor([roughness]), torch.ones(1, 3))
    assert metal.mean().item() == pytest.approx(table.mean().item(), abs=0.01)
    coated = sum(estimates(WHITE, view, roughness, albedo=(1.0, 1.0, 1.0), metallic=0.0, conserving=True))
    assert coated.mean().item() == pytest.approx(1, abs=0.01)  # white below a coat: all comes back, none is made


def test_the_same_shading_as_split_sum_where_light_is_plain():
    """Under a constant light both are exact: the estimate, the prefiltered light and the table agree."""
    g = torch.Generator().manual_seed(2)
    points = 40
    normal = unit(torch.randn(points, 3, generator=g))
    view = unit(normal + 0.5 * torch.randn(points, 3, generator=g))
    albedo, roughness, metallic = torch.rand(points, 3, generator=g), torch.rand(points, generator=g), torch.rand(points, generator=g)
    light = torch.full((8, 16, 3), 0.7)
    samples = draw(view, normal, roughness, (1024, 1024, 0), LightDistribution(light), g)
    for conserving in (False, True):
        parts = reflect_light(view, normal, albedo, roughness, metallic, samples, torch.full_like(samples.direction, 0.7), conserving)
        stack = specular_light(light)
        table = shade(view, normal, albedo, roughness, metallic, diffuse_light(light), stack, conserving)
        assert (sum(parts) - table).abs().max() < 0.01


# --- gradients


def small_problem(points=5, silhouette=False):
    g = torch.Generator().manual_seed(4)
    normal = unit(torch.randn(points, 3, generator=g, dtype=F64))
    view = unit(normal + 0.5 * torch.randn(points, 3, generator=g, dtype=F64))
    if silhouette:
        view = unit(view - 1.3 * (view * normal).sum(-1, keepdim=True) * normal)
    roughness = 0.2 + 0.7 * torch.rand(points, generator=g, dtype=F64)
    albedo, metallic = (0.1 + 0.8 * torch.rand(points, *s, generator=g, dtype=F64) for s in ((3,), ()))
    samples = draw(view, normal, roughness, (3, 2, 3), LightDistribution(soft_light().double()), g)
    incoming = torch.rand(points, 8, 3, generator=g, dtype=F64)
    return view, normal, albedo, roughness, metallic, samples, incoming


@pytest.mark.parametrize("conserving", [False, True])
@pytest.mark.parametrize("silhouette", [False, True])
def test_gradients_in_double_against_finite_differences(conserving, silhouette):
    *inputs, samples, incoming = small_problem(silhouette=silhouette)
    leaves = [t.requires_grad_() for t in (*inputs, incoming)]
    assert torch.autograd.gradcheck(lambda *t: reflect_light(*t[:5], samples, t[5], conserving), leaves, atol=1e-6, rtol=1e-4)


@pytest.mark.parametrize("conserving", [False, True])
def test_gradients_in_single_against_double(conserving):
    *inputs, samples, incoming = small_problem(200)
    inputs[3] = 0.05 + 0.95 * torch.rand(200, generator=torch.Generator().manual_seed(1), dtype=F64)
    weights = torch.randn(2, 200, 3, generator=torch.Generator().manual_seed(6), dtype=F64)
    found = {}
    for dtype in (F64, torch.float32):
        leaves = [t.detach().to(dtype).requires_grad_() for t in (*inputs, incoming)]
        drawn = Samples(samples.direction.to(dtype), samples.density.to(dtype))
        parts = reflect_light(*leaves[:5], drawn, leaves[5], conserving)
        torch.stack(parts).mul(weights.to(dtype)).sum().backward()
        found[dtype] = [*parts, *(leaf.grad for leaf in leaves)]
    for exact, single in zip(found[F64], found[torch.float32], strict=True):
        assert (single - exact).abs().max() < 2e-3 * exact.abs().max()
        assert ((single - exact).abs() < 1e-3 * exact.abs() + 1e-5 * exact.abs().max()).double().mean() > 0.99


def test_samples_below_the_horizon_bring_nothing_and_no_gradient():
    view, normal, *materials, _, _ = small_problem(2)
    below = unit(torch.stack([-normal + 0.3 * view, -normal, normal - 3 * view], 1))
    below = torch.where((below * normal[:, None]).sum(-1, keepdim=True) < 0, below, -below)
    samples = Samples(below, torch.full((2, 3), 0.5, dtype=F64))
    leaves = [t.requires_grad_() for t in (normal, *materials, torch.ones(2, 3, 3, dtype=F64))]
    diffuse, specular = reflect_light(view, *leaves[:4], samples, leaves[4])
    assert not diffuse.any() and not specular.any()
    (diffuse.sum() + specular.sum()).backward()
    for leaf in leaves:
        assert leaf.grad is not None and not leaf.grad.any()


def test_extremes_stay_finite():
    """Views along, against and across the normal, mirrors, and light from the eye and at the horizon."""
    normal = torch.tensor([[0, 0, 1.0]]).repeat(6, 1)
    view = torch.tensor([[0, 0, 1.0], [0, 0, -1], [1, 0, 0], [0, 1, 1e-7], [0.6, 0, -0.8], [0, 1, -1e-7]])
    direction = torch.tensor([[0, 0, 1.0], [1, 0, 0], [-1, 0, 1e-7], [0, -1, 0], [0, 0, -1], [0.6, 0, 0.8]]).repeat(6, 1, 1)
    for roughness in (0.0, 0.05, 1.0):
        leaves = [normal.clone(), torch.rand(6, 3), torch.full((6,), roughness), torch.rand(6), torch.ones(6, 6, 3)]
        leaves = [leaf.requires_grad_() for leaf in leaves]
        parts = reflect_light(view, *leaves[:4], Samples(direction, torch.full((6, 6), 1e-3)), leaves[4])
        torch.stack(parts).sum().backward()
        assert all(torch.isfinite(t).all() for t in (*parts, *(leaf.grad for leaf in leaves)))


def test_irgs_has_a_full_diffuse_lobe_and_no_metal():
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    slanted = torch.nn.functional.normalize(torch.tensor([[[1.0, 0.0, 1.0]]], dtype=torch.float64), dim=-1)
    samples, incoming = Samples(slanted, torch.ones(1, 1).double()), torch.ones(1, 1, 3).double()
    surface = (torch.full((1, 3), 0.6).double(), torch.tensor([0.7]).double())
    results = [reflect_light(up, up, *surface, torch.tensor([m]).double(), samples, incoming, brdf="irgs") for m in (0.0, 1.0)]
    n_l, value, power = irgs_lobe(up, up, surface[1], slanted)
    for diffuse, specular in results:
        assert torch.allclose(diffuse, n_l * 0.6 / math.pi) and torch.allclose(specular, n_l * value * (0.04 + 0.96 * power))


def test_gradients_of_irgs_in_double_against_finite_differences():
    *inputs, samples, incoming = small_problem()
    leaves = [t.requires_grad_() for t in (*inputs, incoming)]
    assert torch.autograd.gradcheck(lambda *t: reflect_light(*t[:5], samples, t[5], brdf="irgs"), leaves, atol=1e-6, rtol=1e-4)
