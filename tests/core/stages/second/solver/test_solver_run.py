# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver's start is the one that explains the photographs better; the schedule is told step by step."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.stages.second.solver import solver_run
from irgspp.core.stages.second.solver.albedo_prior import DARK_ALBEDO, MEDIUM_ALBEDO
from irgspp.core.stages.second.solver.light_material_solver import STEPS, LightMaterialSolver
from irgspp.core.stages.second.solver.solver_run import (
    COARSE_STEPS,
    GLOSSY_PASSES,
    SPLIT_STEPS,
    START_STEPS,
    TOTAL_STEPS,
    _glossy_where_better,
    _with_final_metal,
    run_solver,
)
from sphere_on_floor import make, rendered, start


@pytest.fixture(scope="module")
def scene():
    return make(120, 60)


@pytest.fixture(scope="module")
def settled(scene):
    """A solver run to its end, the steps that were told, and the change of its roughness by a further pass."""
    transfer, seen, _ = scene
    told = []
    solver = run_solver(start(seen, transfer), on_step=told.append)
    return solver, told, solver.copied().settle()


@pytest.fixture
def idle(monkeypatch):
    """Let the solver's steps do nothing and its start be the only one, for tests of their order alone."""
    monkeypatch.setattr(LightMaterialSolver, "advance", lambda self, done: None)
    monkeypatch.setattr(solver_run, "_glossy_where_better", lambda solver, _: solver)


def unsplit(transfer, light):
    """Leave the texels as they are."""
    return transfer, np.arange(transfer.texels.count)


def test_a_dark_glossy_object_is_found_under_its_bright_light(scene):
    transfer, seen, (light, albedo, roughness, metallic) = scene
    dark, gloss = 0.03 * albedo / albedo.mean(), torch.full_like(roughness, 0.15)
    seen = replace(seen, colour=rendered(seen, transfer, 8 * light, dark, gloss, 0 * metallic))
    plain, chosen = start(seen, transfer), start(seen, transfer)
    run_solver(plain)
    chosen = run_solver(chosen, unsplit)
    assert plain.start_albedo == MEDIUM_ALBEDO and chosen.start_albedo == DARK_ALBEDO
    assert chosen.total_error() < 0.8 * plain.total_error()
    error = [abs(float((solver.light.mean() / (8 * light).mean()).log())) for solver in (plain, chosen)]
    assert error[1] < min(0.5 * error[0], 0.3)


def test_no_dark_start_is_tried_where_none_is_asked_for(scene, idle, monkeypatch):
    transfer, seen, _ = scene
    monkeypatch.setattr(solver_run, "_dark_start_is_better", lambda *_: True)
    chosen, without = start(seen, transfer), start(seen, transfer)
    run_solver(chosen, unsplit, lambda done: True)
    run_solver(without, unsplit, lambda done: True, try_dark=False)
    assert (chosen.start_albedo, without.start_albedo) == (DARK_ALBEDO, MEDIUM_ALBEDO)


def test_the_start_stays_where_it_explains_the_photographs_as_well(scene, settled):
    transfer, seen, _ = scene
    both = run_solver(start(seen, transfer), unsplit)
    assert both.start_albedo == MEDIUM_ALBEDO and both.total_error() == pytest.approx(settled[0].total_error(), rel=1e-3)


@pytest.mark.parametrize(("error", "taken"), [(0.98, True), (0.995, False), (1.0, False)])
def test_coarse_light_is_taken_back_where_it_is_clearly_better(scene, monkeypatch, error, taken):
    transfer, seen, _ = scene
    solver, coarse, original = start(seen, transfer), [], LightMaterialSolver.copied
    monkeypatch.setattr(LightMaterialSolver, "copied", lambda self: coarse.append(original(self)) or coarse[-1])
    monkeypatch.setattr(LightMaterialSolver, "total_error", lambda self: error if self in coarse else 1.0)
    monkeypatch.setattr(LightMaterialSolver, "settle", lambda self: 0.0)
    monkeypatch.setattr(solver_run, "_glossy_where_better", lambda solver, _: solver)
    steps = []
    monkeypatch.setattr(LightMaterialSolver, "advance", lambda self, done: self in coarse and steps.append(done))
    result = run_solver(solver, unsplit, try_dark=False)
    assert result is (coarse[0] if taken else solver) and len(coarse) == 1
    assert steps == list(range(SPLIT_STEPS[0], STEPS if taken else COARSE_STEPS))  # otherwise given up early


@pytest.mark.parametrize("last", [3, SPLIT_STEPS[0] + 3, STEPS])
def test_steps_are_told_once_each_and_may_end_the_run(scene, idle, last):
    transfer, seen, _ = scene
    told = []
    run_solver(start(seen, transfer), unsplit, lambda done: told.append(done) or done == last)
    assert told == [0] * START_STEPS + list(range(1, last + 1))


def test_light_and_roughness_settle(scene, settled, monkeypatch):
    transfer, seen, (light, _, roughness, metallic) = scene
    done, told, change = settled
    monkeypatch.setattr(solver_run, "TOTAL_STEPS", STEPS)  # no pass
    unsettled = run_solver(start(seen, transfer))
    assert told[-1] <= TOTAL_STEPS and told[:STEPS] == list(range(1, STEPS + 1))
    assert change < unsettled.settle()
    dull = metallic == 0
    gloss, before = (float((solver.roughness - roughness)[dull].abs().mean()) for solver in (done, unsettled))
    assert gloss < before
    error, error_before = (float((solver.light / light).log().abs().mean()) for solver in (done, unsettled))
    assert error < error_before


@pytest.mark.parametrize(("share", "loss", "taken"), [(0.3, 1.1, True), (0.3, 1.2, False), (0.15, 1.2, True)])
def test_metal_that_more_than_doubles_must_not_be_explained_worse(scene, monkeypatch, share, loss, taken):
    """A tenth of the points is metal, then `share`; the errors of all points are `loss` times as large where it grew."""
    transfer, seen, _ = scene
    solver, turned = start(seen, transfer), []
    few, many = (torch.arange(len(solver.metallic)) < part * len(solver.metallic) for part in (0.1, share))
    solver.metallic = few.float()
    monkeypatch.setattr(LightMaterialSolver, "grow_metal", lambda self: setattr(self, "metallic", many.float()))
    monkeypatch.setattr(LightMaterialSolver, "turn_metal", lambda self: turned.append(self))
    error = lambda self: torch.full_like(self.metallic, loss if bool((self.metallic > few).any()) else 1.0)  # noqa: E731
    monkeypatch.setattr(LightMaterialSolver, "point_errors", error)
    found, ended = _with_final_metal(solver, lambda done: None)
    assert not ended and turned[-1] is found
    assert (found.metallic > 0).equal(many if taken else few) and (found is solver) == taken


@pytest.fixture(scope="module")
def too_rough(scene):
    """A solver that took gloss for rough paint, and the true roughness of all points."""
    transfer, seen, (light, albedo, roughness, metallic) = scene
    gloss = torch.full_like(roughness, 0.25)
    solver = start(replace(seen, colour=rendered(seen, transfer, light, albedo, gloss, 0 * metallic)), transfer)
    solver.set_roughness(torch.full_like(roughness, 0.8), 20)
    return solver, gloss


def test_a_second_start_finds_gloss_that_was_taken_for_rough_paint(too_rough):
    solver, gloss = too_rough
    before, told = solver.total_error(), []
    found = _glossy_where_better(solver, told.append)
    assert set(told) == {TOTAL_STEPS}  # progress never goes back
    assert found.started_glossy and not solver.started_glossy
    assert found.total_error() < 0.5 * before and solver.total_error() == before
    assert float((found.roughness - gloss).abs().mean()) < 0.1


@pytest.mark.parametrize(("error", "taken"), [(0.96, True), (0.98, False)])
def test_a_second_start_must_be_clearly_better(too_rough, monkeypatch, error, taken):
    solver, settled = too_rough[0], []
    monkeypatch.setattr(LightMaterialSolver, "set_roughness", lambda self, *_: None)
    monkeypatch.setattr(LightMaterialSolver, "total_error", lambda self: error if self.started_glossy else 1.0)
    monkeypatch.setattr(LightMaterialSolver, "settle", lambda self: settled.append(self) or 0.0)
    found = _glossy_where_better(solver, lambda done: None)
    assert found.started_glossy == taken and (found is solver) == (not taken)
    assert len(settled) == (2 * GLOSSY_PASSES + 1 if taken else GLOSSY_PASSES)


@pytest.mark.parametrize(("error", "taken"), [(0.99, True), (0.92, False)])
def test_a_second_start_must_be_better_than_the_same_from_its_own_roughness(too_rough, monkeypatch, error, taken):
    """`error`: of the copy with the solver's own roughness."""
    solver, copies, original = too_rough[0], [], LightMaterialSolver.copied
    monkeypatch.setattr(LightMaterialSolver, "copied", lambda self: copies.append(original(self)) or copies[-1])
    monkeypatch.setattr(LightMaterialSolver, "set_roughness", lambda self, *_: setattr(self, "moved", True))
    monkeypatch.setattr(LightMaterialSolver, "settle", lambda self: 0.0)
    errors = lambda self: 0.93 if self.started_glossy else error if getattr(self, "moved", False) else 1.0  # noqa: E731
    monkeypatch.setattr(LightMaterialSolver, "total_error", errors)
    assert _glossy_where_better(solver, lambda done: None).started_glossy == taken
    assert len(copies) == 2


def test_the_run_may_end_in_a_second_start(too_rough):
    assert _glossy_where_better(too_rough[0], lambda done: True) is too_rough[0]


def test_the_roughness_of_metal_stays_while_the_rest_settles(scene):
    transfer, seen, (*_, metallic) = scene
    solver = start(seen, transfer)
    solver.metallic = metallic
    before = solver.roughness
    assert solver.settle() > 0
    changed = solver.roughness != before
    assert not changed[metallic > 0].any() and changed[metallic == 0].any()


def test_settling_ends_where_the_roughness_stays_or_it_is_asked_to(scene, idle, monkeypatch):
    transfer, seen, _ = scene
    changes, passes = [0.1, 0.05, 1e-3, 0.1], []
    monkeypatch.setattr(LightMaterialSolver, "settle", lambda self: passes.append(changes[len(passes)]) or passes[-1])
    run_solver(start(seen, transfer))
    assert passes == changes[:3]
    passes.clear()
    run_solver(start(seen, transfer), on_step=lambda done: done == STEPS + 1)
    assert passes == changes[:1]
    passes.clear()
    run_solver(start(seen, transfer), on_step=lambda done: done == STEPS)
    assert not passes


def test_the_run_may_end_while_starts_are_compared(scene):
    transfer, seen, _ = scene
    ended, first = start(seen, transfer), start(seen, transfer)
    ended = run_solver(ended, unsplit, lambda done: True)
    first.advance(0)
    first.reduce_tint()
    assert torch.equal(ended.light, first.light) and torch.equal(ended.albedo, first.albedo)


def test_some_points_alone_are_solved_alike(scene):
    transfer, seen, _ = scene
    whole, part = start(seen, transfer), start(seen, transfer).subsampled(2)
    points = torch.arange(0, len(seen.position), 2)
    assert torch.equal(part.samples.position, seen.position[points])
    assert torch.equal(part.samples.lengths, seen.lengths[points])
    assert torch.equal(part.samples.colour, seen.colour[torch.isin(seen.point, points)])
    assert part.total_error() < whole.total_error()
    errors = [solver.error() for solver in (whole, part)]
    assert errors[1] == pytest.approx(errors[0], rel=0.2)
