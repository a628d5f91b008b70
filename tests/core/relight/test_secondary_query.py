# SPDX-License-Identifier: GPL-3.0-or-later
"""Both backends against the analytic occlusion by a ball and against vertex data that are linear in space."""

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.relight.backends import open_relighter
from irgspp.core.relight.mesh_query import MeshQuery
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.scene.mesh import Mesh
from irgspp.core.shading.sampling import point_set

pytestmark = pytest.mark.usefixtures("engine")
BACKENDS = ("mesh", "gaussian")
BALL = ((np.zeros(3), 1.0),)


def cosine_rays(point, count=40_000):
    u = point_set(count).float()
    r, phi = u[:, 0].sqrt(), 2 * torch.pi * u[:, 1]
    return torch.tensor(point).float().expand(count, 3), torch.stack([r * phi.cos(), r * phi.sin(), (1 - u[:, 0]).sqrt()], -1)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("aside", [0.0, 1.0, 2.5])
def test_a_ball_above_a_plane_hides_its_form_factor_of_the_sky(relighter, backend, aside):
    """r^2 h / d^3 for a sphere of radius r wholly above the horizon, at height h and distance d."""
    query, height = relighter(backend, balls=BALL).query, 1.6
    hits = query.hits(*cosine_rays((aside, 0.0, -height)))
    hidden = float(hits.opacity.sum()) / 40_000
    assert hidden == pytest.approx(height / np.hypot(height, aside) ** 3, rel=0.02 if backend == "mesh" else 0.05, abs=2e-3)


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_is_hidden_is_the_opacity_of_what_is_met(relighter, backend):
    query, (origin, direction) = relighter(backend).query, cosine_rays((0.3, 0.2, -1.5), 4000)
    hits, expected = query.hits(origin, direction), torch.zeros(4000)
    expected[hits.ray] = hits.opacity
    assert 0.1 < expected.mean() < 0.9
    torch.testing.assert_close(query.hidden(origin, direction), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_hits_tell_material_and_a_normal_against_the_ray(relighter, backend):
    query = relighter(backend, (0.6, 0.4, 0.2, 0.7, 0.3), BALL).query
    origin, direction = cosine_rays((0.3, 0.2, -1.5), 4000)
    hit = query.hits(origin, direction)
    o, d = origin[hit.ray].double(), direction[hit.ray].double()
    clear = hit.opacity > 0.99
    assert clear.sum() > 500 and (hit.ray.diff() > 0).all()
    along = -(o * d).sum(-1)
    normal = o + (along - (along**2 - (o * o).sum(-1) + 1).clamp_min(0).sqrt())[:, None] * d
    assert torch.allclose(hit.albedo[clear], torch.tensor([0.6, 0.4, 0.2]), atol=1e-4)
    assert torch.allclose(hit.roughness[clear], torch.tensor(0.7), atol=1e-4)
    assert torch.allclose(hit.metallic[clear], torch.tensor(0.3), atol=1e-4)
    assert ((hit.normal * normal).sum(-1)[clear] > 0.97).float().mean() > 0.98
    assert (hit.normal.double() * d).sum(-1)[clear].max() < 1e-5
    inside = query.hits(torch.zeros(100, 3), direction[:100])  # from within, every ray meets the back
    assert len(inside.ray) == 100 and ((inside.normal * direction[:100]).sum(-1) < -0.9).all()


def test_mesh_interpolates_its_vertices():
    """Materials that are linear in space come out exactly where the ray meets the triangle."""
    rng = np.random.default_rng(0)
    vertices = np.float32([[0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]])
    albedo = (vertices @ np.float32([[0.1, 0.2, 0], [0.3, 0, 0.1], [0, 0, 0]]) + 0.05).astype(np.float32)
    numbers = (vertices[:, 0] / 4, vertices[:, 1] / 4)
    up = np.tile(np.float32([0, 0, 1]), (4, 1))
    query = MeshQuery(Mesh(vertices, up, up[:, :2], np.int32([[0, 1, 2], [1, 3, 2]]), albedo, *numbers), 1.0)
    target = np.concatenate([rng.uniform(-0.5, 2.5, (500, 2)), np.zeros((500, 1))], 1)
    origin = target + rng.normal(0, 0.3, (500, 3)) * [1, 1, 0] + [0, 0, 1]
    direction = (target - origin) / np.linalg.norm(target - origin, axis=1, keepdims=True)
    hit = query.hits(torch.from_numpy(origin).float(), torch.from_numpy(direction).float())
    within = ((target[:, :2] > 0) & (target[:, :2] < 2)).all(1)
    assert np.array_equal(hit.ray.numpy(), np.flatnonzero(within)) and within.sum() > 100
    assert (hit.opacity == 1).all()
    at = target[within]
    np.testing.assert_allclose(hit.roughness, at[:, 0] / 4, atol=1e-5)
    np.testing.assert_allclose(hit.metallic, at[:, 1] / 4, atol=1e-5)
    np.testing.assert_allclose(hit.albedo[:, 0], 0.1 * at[:, 0] + 0.3 * at[:, 1] + 0.05, atol=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_rays_start_outside_the_surface_they_leave(relighter, camera, backend):
    """Along the normals of a single ball nothing occludes."""
    one = relighter(backend, balls=BALL)
    surface = one.surface(camera)
    solid = surface.alpha > 0.9
    hits = one.query.hits(surface.origin[solid], surface.normal[solid])
    assert float(hits.opacity.sum()) / int(solid.sum()) < 0.003


def test_mesh_normals_are_averaged_with_those_of_the_gaussians(relighter, camera):
    one = relighter("mesh")
    splats, both, mesh = (one.query.refined(one.surface(camera), weight).normal for weight in (0.0, 0.5, 1.0))
    assert torch.allclose(torch.nn.functional.normalize(splats + mesh, dim=1), torch.nn.functional.normalize(both, dim=1), atol=0.05)
    assert (splats - mesh).abs().max() > 1e-3


def test_run_without_a_mesh(relighter, tmp_path):
    scene = relighter("gaussian").reconstruction
    assert open_relighter(tmp_path, scene, "gaussian", RelightSettings()).counts == (128, 128, 256)
    with pytest.raises(InputError, match=r"mesh\.ply.*--backend mesh.*--resume"):
        open_relighter(tmp_path, scene, "mesh", RelightSettings())
