# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts of a metal's refinement: the first stage's detail of the light at the solver's levels."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.gaussians import ALBEDO, METALLIC, ROUGHNESS
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.metal_starts import MAX_EXPLAINED_ERROR, albedo_ratio, levelled_light, metal_starts

SCALE = torch.tensor([0.5, 0.8, 1.25])


def sphere(splat_sphere, albedo, roughness, metallic, light):
    material = torch.tensor([*albedo, roughness, metallic])[:, None].expand(5, 500)
    surfels = replace(splat_sphere(500), material=torch.logit(material).contiguous())
    return Reconstruction(surfels, light, Bound((0.0, 0.0, 0.0), 1.5), np.eye(4), True)


@pytest.fixture
def parts(splat_sphere):
    """First stage, solved reconstruction and solver: the solver's albedo is SCALE times that of the first stage."""
    sharp = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    first = sphere(splat_sphere, (0.8, 0.5, 0.4), 0.2, 0.9, sharp)
    solved = sphere(splat_sphere, tuple(SCALE * torch.tensor([0.8, 0.5, 0.4])), 0.6, 0.998, torch.ones(64, 128, 3))
    position = first.gaussians.position.T[::5].contiguous()
    albedo = SCALE * torch.tensor([0.8, 0.5, 0.4]).expand(len(position), 3)
    light = torch.full((8 * 16, 3), 2.0)
    texels = LightTexels.uniform(8)
    known = {"light": light, "albedo": albedo, "samples": SimpleNamespace(position=position)}
    known |= {"error": lambda: 0.02, "transfer": SimpleNamespace(texels=texels), "light_map": lambda height: texels.map(light, height)}
    return first, solved, SimpleNamespace(**known)


def test_light_takes_the_levels_and_keeps_the_detail():
    random = torch.Generator().manual_seed(0)
    detail, levels = torch.rand(64, 128, 3, generator=random) + 0.5, torch.full((8, 16, 3), 3.0)
    light = levelled_light(detail, levels)
    means = light.reshape(8, 8, 16, 8, 3).mean((1, 3))
    np.testing.assert_allclose(means, levels, rtol=0.1)
    log = torch.stack([light.log().flatten(), detail.log().flatten()])
    assert torch.corrcoef(log)[0, 1] > 0.95


def test_light_of_the_right_levels_stays():
    detail = torch.rand(64, 128, 3, generator=torch.Generator().manual_seed(0)) + 0.5
    levels = detail.reshape(8, 8, 16, 8, 3).mean((1, 3))
    np.testing.assert_allclose(levelled_light(detail, levels), detail, rtol=1e-5)


def test_dark_detail_stays_finite():
    light = levelled_light(torch.zeros(16, 32, 3), torch.ones(4, 8, 3))
    assert torch.isfinite(light).all() and (light == 0).all()


def test_ratio_of_the_albedos_is_found(parts):
    first, _, solver = parts
    np.testing.assert_allclose(albedo_ratio(first, solver), SCALE, rtol=1e-4)


def test_starts_have_the_same_roughness_and_reflect_the_same(parts):
    first, solved, solver = parts
    starts = metal_starts(first, solved, solver)
    by_solver, by_first = (start.gaussians.materials() for start in starts)
    np.testing.assert_allclose(by_solver[ALBEDO], solved.gaussians.materials()[ALBEDO], rtol=1e-5)
    np.testing.assert_allclose(by_first[ALBEDO], SCALE[:, None] * first.gaussians.materials()[ALBEDO], rtol=1e-5)
    for materials in (by_solver, by_first):
        np.testing.assert_allclose(materials[METALLIC], 0.998, rtol=1e-3)
        np.testing.assert_allclose(materials[ROUGHNESS], 0.2, rtol=1e-4)
    assert all(start.environment.shape == (64, 128, 3) for start in starts)
    assert torch.equal(starts[0].environment, starts[1].environment)  # the metal's colour is not in the light
    reflected = [start.environment * materials[ALBEDO, 0] for start, materials in zip(starts, (by_solver, by_first), strict=True)]
    np.testing.assert_allclose(*reflected, rtol=1e-3)


def test_an_albedo_stays_below_one(parts):
    first, solved, solver = parts
    solver.albedo = 2 * solver.albedo
    albedo = metal_starts(first, solved, solver)[1].gaussians.materials()[ALBEDO]
    assert (albedo < 1).all() and (albedo[2] > 0.98).all()  # 0.4 * 1.25 * 2


@pytest.mark.parametrize(("error", "count"), [(0.9 * MAX_EXPLAINED_ERROR, 1), (1.1 * MAX_EXPLAINED_ERROR, 2)])
def test_the_solver_starts_alone_where_it_explains_the_photographs(parts, error, count):
    first, solved, solver = parts
    solver.error = lambda: error
    starts = metal_starts(first, solved, solver)
    assert len(starts) == count and (starts[0] is solved) == (count == 1)
