# SPDX-License-Identifier: GPL-3.0-or-later
"""Assignment of materials to the Gaussians of a sphere under a white sky, whose radiance is known in closed form."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from irgspp.core.io.srgb import encode_srgb
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.dataset import Bound, View
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.spherical_harmonics import SH_C0
from irgspp.core.scene.surface import Surface
from irgspp.core.shading.brdf import base_reflectance
from irgspp.core.shading.specular_albedo import diffuse_fraction, specular_albedo
from irgspp.core.stages.second.solver import gaussian_materials as module
from irgspp.core.stages.second.solver.gaussian_materials import (
    LOGIT_MARGIN,
    assign_materials,
    fitted_albedo,
    surface_normals,
)
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples
from irgspp.core.stages.second.solver.transfer_tracing import trace_radiance_transfer

COUNT, INSIDE, HEIGHT = 3000, 40, 8
SKY, ROUGHNESS = 0.7, 0.6


def materials(position):
    """Return albedo (..., 3) and metallic (...): a red and a blue half, and a metal top."""
    albedo = np.where(position[..., :1] > 0, [0.6, 0.2, 0.1], [0.1, 0.3, 0.5])
    return torch.from_numpy(albedo), torch.from_numpy((position[..., 2] > 0.5).astype(float))


def shown(position, toward):
    """Return the radiance (K, 3) of points of the sphere."""
    albedo, metallic = materials(position)
    n_v = torch.from_numpy((position * toward).sum(-1).clip(1e-3, 1))
    rough = torch.full_like(n_v, ROUGHNESS)
    body = (1 - metallic)[:, None] * albedo * diffuse_fraction(n_v, rough)[:, None]
    return SKY * (body + specular_albedo(n_v, rough, base_reflectance(albedo, metallic[:, None]))).numpy()


def photograph(camera):
    ray = camera.rays().astype(float).reshape(-1, 3)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ray @ camera.centre
    root = along**2 - camera.centre @ camera.centre + 1
    point = camera.centre + (-along - np.sqrt(np.maximum(root, 0)))[:, None] * ray
    colour = np.where(root[:, None] >= 0, shown(point, -ray), 0).reshape(camera.height, camera.width, 3)
    return View("a", camera, Path("a.png"), encode_srgb(colour).astype(np.float32), None)


@pytest.fixture(scope="module")
def views(camera_ring):
    return [photograph(c) for c in camera_ring(20, 96)]


@pytest.fixture(scope="module")
def surface():
    mesh = trimesh.creation.icosphere(4)
    return Surface(np.array(mesh.vertices), np.array(mesh.vertex_normals), np.array(mesh.faces), 0.05)


def reconstruction(splat_sphere, glossy):
    """Return the sphere with its radiance along the normal, in SH alone or with reflections, and some hidden surfels inside it."""
    sphere = splat_sphere(COUNT, opacity=0.99)
    position = sphere.position.T.double().numpy()
    albedo, metallic = materials(position)
    rough = torch.full_like(metallic, ROUGHNESS)
    radiance = SKY * albedo * diffuse_fraction(torch.ones_like(rough), rough)[:, None] if glossy else shown(position, position)
    sphere.sh[0] = (torch.as_tensor(radiance).float().T - 0.5) / SH_C0
    sphere.material = torch.logit(torch.cat([albedo.T, rough[None], metallic[None]]).float().clamp(LOGIT_MARGIN, 1 - LOGIT_MARGIN))
    hidden = sphere.select(torch.arange(0, COUNT, COUNT // INSIDE)[:INSIDE])
    hidden.position *= 0.8
    return Reconstruction(sphere.joined(hidden), torch.full((8, 16, 3), SKY), Bound((0, 0, 0), 1.0), np.eye(4), glossy)


@pytest.fixture(scope="module")
def found(splat_sphere):
    """Results that the light-material solver would have at points of the sphere."""
    position = splat_sphere(400).position.T.contiguous()
    albedo, metallic = (values.float() for values in materials(position.double().numpy()))
    about = SimpleNamespace(texels=LightTexels.uniform(HEIGHT), has_indirect=True, rotations=None)
    light = torch.full((2 * HEIGHT**2, 3), SKY)
    seen = SimpleNamespace(position=position)
    known = {"albedo": albedo, "roughness": torch.full((400,), ROUGHNESS), "metallic": metallic}
    return SimpleNamespace(samples=seen, transfer=about, light=light, **known)


def assigned(scene, surface, views, found, seed=0):
    reported = []
    result = assign_materials(scene, surface, views, SecondaryTracer(scene), found, seed, reported.append)
    assert reported == sorted(reported) and reported[-1] == 1.0
    return result


@pytest.mark.parametrize("glossy", [False, True])
def test_materials_are_found_and_hidden_surfels_are_like_their_neighbours(splat_sphere, surface, views, found, glossy, monkeypatch):
    monkeypatch.setattr(module, "BATCH", 700)
    scene = reconstruction(splat_sphere, glossy)
    result = assigned(scene, surface, views, found)
    assert result.shape == (5, COUNT + INSIDE) and result.dtype == torch.float32 and result.is_contiguous()
    assert result.min() >= LOGIT_MARGIN and result.max() <= 1 - LOGIT_MARGIN and torch.logit(result).isfinite().all()
    position = scene.gaussians.position.T.double().numpy()
    albedo, metallic = materials(position)
    inner = (np.abs(position[:COUNT, 0]) > 0.15) & (np.abs(position[:COUNT, 2] - 0.5) > 0.1)  # away from the borders of colours and metal
    error = (result[:3, :COUNT].T - albedo[:COUNT])[inner].abs()
    limit = 0.01 if glossy else 0.02  # SH that are equal in all directions only approximate the sphere
    assert error.median() < limit and error.quantile(0.95) < 3 * limit
    np.testing.assert_allclose(result[3], ROUGHNESS, rtol=1e-5)
    np.testing.assert_allclose(result[4, :COUNT][inner], metallic[:COUNT][inner].clamp(LOGIT_MARGIN, 1 - LOGIT_MARGIN), rtol=1e-5)
    above = torch.arange(0, COUNT, COUNT // INSIDE)[:INSIDE]  # the visible surfels right above the hidden ones
    same = (result[:, above] == result[:, COUNT:]).all(0)
    assert same.float().mean() > 0.9  # the others are nearer to another one


def test_same_seed_same_bits(splat_sphere, surface, views, found):
    scene = reconstruction(splat_sphere, True)
    one, same, other = (assigned(scene, surface, views, found, seed) for seed in (0, 0, 1))
    assert torch.equal(one, same) and not torch.equal(one, other)


def test_normals_are_the_surface_s(surface):
    random = np.random.default_rng(0).normal(size=(200, 3))
    position = random / np.linalg.norm(random, axis=1, keepdims=True)
    normal = surface_normals(surface, 1.1 * position)
    assert normal.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-6)
    assert (normal * position).sum(1).min() > 0.995
    few = Surface(surface.vertices[:1], surface.normals[:1], surface.faces[:0], 0.1)
    np.testing.assert_allclose(surface_normals(few, position[:2]), np.tile(surface.normals[:1], (2, 1)), atol=1e-6)


def test_normals_on_a_thin_sheet_are_those_of_one_side():
    random = np.random.default_rng(0)
    plane = random.uniform(-1, 1, (4000, 2))
    upper = np.arange(4000) < 2000
    vertices = np.column_stack([plane, np.where(upper, 0.01, -0.01)]).astype(np.float32)
    normals = np.column_stack([np.zeros((4000, 2)), np.where(upper, 1, -1)]).astype(np.float32)
    places = random.uniform(-0.9, 0.9, (500, 2))
    for height in (0.009, -0.009):
        normal = surface_normals(
            Surface(vertices, normals, np.zeros((0, 3), np.int32), 0.02), np.column_stack([places, np.full(500, height)])
        )
        sides = np.sign(normal[:, 2])
        np.testing.assert_allclose(normal, sides[:, None] * [0, 0, 1], atol=1e-6)  # the mean of both sides would be anything
        assert (sides == np.sign(height)).mean() > 0.9


@pytest.fixture(scope="module")
def lit(splat_sphere):
    """Points of the sphere under a light of many colours with samples from five sides, and their ground truth."""
    scene = reconstruction(splat_sphere, False)
    random = torch.Generator().manual_seed(2)
    position = torch.nn.functional.normalize(torch.randn(50, 3, generator=random), dim=1)
    transfer = trace_radiance_transfer(
        position, position.clone(), SecondaryTracer(scene), LightTexels.uniform(HEIGHT), side=1, seed=0, indirect=True
    )
    point = torch.arange(50).repeat_interleave(5)
    view = torch.nn.functional.normalize(position[point] + 0.6 * torch.randn(250, 3, generator=random).clamp(-1, 1), dim=1)
    light = 0.2 + torch.rand(2 * HEIGHT**2, 3, generator=random)
    albedo = 0.1 + 0.8 * torch.rand(50, 3, generator=random)
    roughness, metallic = 0.2 + 0.8 * torch.rand(50, generator=random), (torch.arange(50) % 3 == 0).float()
    seen = MultiViewSamples(position, position, point, view, torch.zeros(250, 3), torch.zeros(250, 3, dtype=torch.bool))
    f0_term, fresnel_term, f0_indirect, fresnel_indirect = transfer.rows(seen, roughness)
    metal, a = metallic[point, None], albedo[point]
    share = diffuse_fraction((position[point] * view).sum(1).clamp_min(1e-3), roughness[point])[:, None]
    body = (1 - metal) * a * share * (transfer.irradiance @ light + transfer.indirect)[point]
    colour = body + base_reflectance(a, metal) * (f0_term @ light + f0_indirect) + fresnel_term @ light + fresnel_indirect
    return replace(seen, colour=colour), transfer, light, roughness, metallic, albedo


def test_albedo_is_fitted_exactly_where_the_model_holds(lit):
    *problem, albedo = lit
    np.testing.assert_allclose(fitted_albedo(*problem).albedo, albedo, rtol=1e-3, atol=1e-4)


def test_an_unrelated_sample_has_no_weight(lit):
    seen, *problem, albedo = lit
    wrong = torch.arange(250)[:, None] % 5 == 2
    for strange in (0.0, 5.0):
        fit = fitted_albedo(replace(seen, colour=torch.where(wrong, strange, seen.colour)), *problem).albedo
        assert ((fit - albedo).abs() / albedo).median() < 0.03


def test_the_error_of_a_fit_tells_which_points_the_model_does_not_explain(lit):
    seen, *problem, _ = lit
    strange = (seen.point % 2 == 0)[:, None] & (torch.arange(250)[:, None] % 5 < 2)
    fit = fitted_albedo(replace(seen, colour=torch.where(strange, 2.0, seen.colour)), *problem)
    assert fit.error[0::2].min() > 1.0 > fit.error[1::2].max()
    assert (fit.precision[1::2] > 0).all()


def test_clipped_views_are_lower_bounds(lit):
    seen, *problem, albedo = lit
    limit = 0.8 * seen.colour
    one = torch.arange(250)[:, None] % 5 == 2
    clipped = MultiViewSamples(seen.position, seen.normal, seen.point, seen.view, torch.where(one, limit, seen.colour), one.expand(-1, 3))
    np.testing.assert_allclose(fitted_albedo(clipped, *problem).albedo, albedo, rtol=1e-2, atol=1e-3)


def test_a_point_that_all_views_clip_is_as_bright_as_they_show_it(lit):
    """No view says how much brighter it is, but it must not become black."""
    seen, *problem, albedo = lit
    everywhere = (seen.point % 2 == 0)[:, None].expand(-1, 3)
    clipped = replace(seen, colour=torch.where(everywhere, 0.8 * seen.colour, seen.colour), saturated=everywhere)
    fit = fitted_albedo(clipped, *problem).albedo
    assert (fit[0::2] > 0.5 * albedo[0::2]).all() and (fit[0::2] < 1.01 * albedo[0::2]).all()
    np.testing.assert_allclose(fit[1::2], albedo[1::2], rtol=1e-3, atol=1e-4)
