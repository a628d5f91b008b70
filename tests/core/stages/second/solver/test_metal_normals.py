# SPDX-License-Identifier: GPL-3.0-or-later
"""Wrong normals of metal turn towards those of its reflections, and no longer look like roughness."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.stages.second.solver import solver_run
from irgspp.core.stages.second.solver.light_material_solver import STEPS
from irgspp.core.stages.second.solver.material_search import MaterialSearch
from irgspp.core.stages.second.solver.metal_normals import (
    RING_ANGLE,
    RINGS,
    SEARCHED_ROUGHNESS,
    TRUSTED_ERROR,
    metal_trust,
    reflected_normals,
    turned_metal,
)
from irgspp.core.stages.second.solver.sample_equation import approximate_srgb_derivative
from irgspp.core.stages.second.solver.solver_run import NORMAL_SEARCHES, run_solver
from sphere_on_floor import make, start


@pytest.fixture(scope="module")
def brass():
    """Samples of points of brass with true normals, the transfer to them, the light, and normals that are wrong by 6 degrees or so."""
    transfer, seen, (light, _, _, metallic) = make(900, 10)
    metal = metallic > 0
    seen, transfer = seen.subset(metal), transfer.subset(metal)
    generator = torch.Generator().manual_seed(0)
    wrong = seen.normal + 0.075 * torch.randn(seen.normal.shape, generator=generator)
    return seen, transfer, light, wrong / wrong.norm(dim=1, keepdim=True)


def angles(one, other):
    """Angles between unit vectors (P, 3), degrees."""
    return torch.rad2deg(torch.acos((one * other).sum(1).clamp(-1, 1)))


def test_wrong_normals_turn_towards_the_true_ones(brass):
    seen, transfer, light, wrong = brass
    found, _ = reflected_normals(replace(seen, normal=wrong), transfer, light, wrong)
    before, after = angles(wrong, seen.normal), angles(found, seen.normal)
    assert before.mean() > 4 and after.mean() < 0.6 * before.mean()
    np.testing.assert_allclose(found.norm(dim=1), 1, atol=1e-5)
    assert float(angles(found, wrong).max()) < np.degrees(RINGS * RING_ANGLE) + 0.1


def test_wrong_normals_are_no_reason_for_roughness(brass):
    seen, transfer, light, wrong = brass
    tilted = replace(seen, normal=wrong)
    _, found = reflected_normals(tilted, transfer, light, wrong)
    search = MaterialSearch(tilted, transfer, transfer.diffuse_rows(tilted), seen.sums(seen.colour) / seen.lengths[:, None])
    derivative = approximate_srgb_derivative(seen.colour)
    fixed = search.roughness(search.costs(light, derivative**2, derivative), torch.ones(len(wrong), dtype=torch.bool))
    assert (found - 0.25).abs().mean() < 0.5 * (fixed - 0.25).abs().mean()
    assert SEARCHED_ROUGHNESS[0] <= float(found.min()) and float(found.max()) <= SEARCHED_ROUGHNESS[-1]


def test_true_normals_stay(brass):
    seen, transfer, light, _ = brass
    found, roughness = reflected_normals(seen, transfer, light, seen.normal)
    assert float(angles(found, seen.normal).median()) < 0.1
    assert (roughness - 0.25).abs().max() < 0.06


def test_normals_are_found_under_a_light_that_turns(brass):
    seen, transfer, light, wrong = brass
    angle = torch.linspace(0, 6, 8)
    zero, one = torch.zeros(8), torch.ones(8)
    rows = (torch.stack([angle.cos(), -angle.sin(), zero]), torch.stack([angle.sin(), angle.cos(), zero]), torch.stack([zero, zero, one]))
    transfer = replace(transfer, rotations=torch.stack(rows).permute(2, 0, 1).contiguous())
    seen = replace(seen, image=torch.arange(len(seen.point)) % 8)
    f0_term, fresnel_term, f0_indirect, fresnel_indirect = transfer.rows(seen, torch.full((len(wrong),), 0.25))
    colour = torch.tensor([0.9, 0.7, 0.4]) * (f0_term @ light + f0_indirect) + fresnel_term @ light + fresnel_indirect
    found, _ = reflected_normals(replace(seen, colour=colour, normal=wrong), transfer, light, wrong)
    assert angles(found, seen.normal).mean() < 0.6 * angles(wrong, seen.normal).mean()


def test_the_solver_turns_metal_alone_and_keeps_the_surface():
    transfer, seen, (light, albedo, roughness, metallic) = make()
    wrong = seen.normal + 0.06 * torch.randn(seen.normal.shape, generator=torch.Generator().manual_seed(0))
    wrong = wrong / wrong.norm(dim=1, keepdim=True)
    solver = start(replace(seen, normal=wrong), transfer)
    solver.light, solver.albedo, solver.roughness, solver.metallic = light, albedo, roughness.clone(), metallic.float()
    solver.turn_metal()
    metal = metallic > 0
    assert torch.equal(solver.surface_normal, wrong) and torch.equal(solver.samples.normal[~metal], wrong[~metal])
    assert angles(solver.samples.normal, seen.normal)[metal].mean() < 0.8 * angles(wrong, seen.normal)[metal].mean()
    assert torch.equal(solver.roughness[~metal], roughness[~metal])


def test_wrong_normals_hide_no_metal_and_make_none():
    """Three quarters of the brass are known; the normals of the rest are wrong by 17 degrees or so."""
    transfer, seen, (light, albedo, roughness, metallic) = make(900, 14)
    metal = metallic > 0
    wrong = seen.normal + 0.2 * torch.randn(seen.normal.shape, generator=torch.Generator().manual_seed(0))
    wrong = wrong / wrong.norm(dim=1, keepdim=True)
    known = metal & (seen.position[:, 0] > seen.position[metal, 0].quantile(0.25))
    hidden = metal & ~known
    seen = replace(seen, normal=torch.where(hidden[:, None], wrong, seen.normal))
    solver = start(seen, transfer)
    solver.light, solver.roughness, solver.metallic = light, roughness.clone(), known.float()
    solver._update_model()
    free, as_metal = turned_metal(seen, transfer, light, seen.normal, known)
    dielectric, fixed = (least / seen.lengths for least in solver._search._least(solver._costs()))
    torch.testing.assert_close(as_metal[known], albedo[known], atol=0.05, rtol=0)
    assert free[hidden].mean() < 0.6 * fixed[hidden].mean()
    assert float((free < dielectric)[metal].float().mean()) > 0.9 > 0.1 > float((free < dielectric)[~metal].float().mean())
    solver.grow_metal()
    assert torch.equal(solver.metallic > 0, metal)


@pytest.mark.parametrize(
    ("metallic", "turns"),
    [((0.0, 0.0, 0.0), 0), ((1.0, 0.0, 0.0), NORMAL_SEARCHES), ((1.0, 1.0, 0.0), NORMAL_SEARCHES), ((1.0, 1.0, 1.0), 0)],
)
def test_a_run_turns_metal_parts_at_its_end(metallic, turns, monkeypatch):
    """Not on an object that is metal as a whole: its normals come from the first stage's reflections."""
    done = []
    solver = SimpleNamespace(
        metallic=torch.tensor(metallic),
        is_all_metal=all(metallic),
        advance=lambda step: done.append("step"),
        copied=lambda: solver,
        grow_metal=lambda: done.append("grow"),
        turn_metal=lambda: done.append("turn"),
        settle=lambda: done.append("settle") or 0.0,
        reduce_tint=lambda: done.append("tint"),
    )
    monkeypatch.setattr(solver_run, "_glossy_where_better", lambda solver, _: done.append("gloss") or solver)
    run_solver(solver)
    settles = not all(metallic)
    assert done == ["step"] * STEPS + ["grow"] * bool(turns) + ["turn"] * turns + ["settle", "gloss"] * settles + ["tint"]


def test_a_run_that_is_ended_at_its_last_step_turns_nothing():
    done = []
    metal = {"metallic": torch.tensor([1.0, 0.0, 0.0]), "is_all_metal": False}
    solver = SimpleNamespace(**metal, advance=done.append, reduce_tint=lambda: done.append("tint"))
    run_solver(solver, on_step=lambda steps: steps == STEPS)
    assert done == [*range(STEPS), "tint"]


def test_metal_that_fits_badly_counts_less_for_the_light():
    error = torch.tensor([0.3, 0.6, 12.0, 12.0, 0.0, 1.0, 0.6])  # median 0.6
    metal = torch.tensor([True, False, True, False, True, True, False])
    expected = torch.tensor([1.0, 1.0, 0.05 * TRUSTED_ERROR, 1.0, 1.0, 1.0, 1.0])
    torch.testing.assert_close(metal_trust(error, metal), expected)
    small = 1e-3 * error  # less than noise makes, so that it tells nothing
    assert (metal_trust(small, metal) == 1).all()
