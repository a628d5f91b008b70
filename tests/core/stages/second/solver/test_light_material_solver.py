# SPDX-License-Identifier: GPL-3.0-or-later
"""Light-material solver on a known scene: a sphere on a floor, with images by the model's own equations.

Visibility is known in closed form here, so nothing is traced.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.kernels.lobes import TracedDirections
from irgspp.core.stages.second.solver import light_material_solver as module
from irgspp.core.stages.second.solver.light_material_solver import STEPS, LightMaterialSolver
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.metal_confirmation import MIN_REGION_GAIN, Hypothesis, completed_metal
from irgspp.core.stages.second.solver.radiance_transfer import RadianceTransfer
from irgspp.core.stages.second.solver.sample_radiance import SampleRadiance
from irgspp.core.stages.second.solver.solver_run import run_solver
from sphere_on_floor import HEIGHT, TEXELS, make, rendered, solved, start, transport


@pytest.fixture(scope="module")
def scene():
    """Radiance transfer, multi-view samples and ground truth."""
    return make()


@pytest.fixture(scope="module")
def found(scene):
    transfer, seen, _ = scene
    return solved(seen, transfer)


def rescaled(solver, truth):
    """Remove the ambiguous factor between light and albedo; return light, albedo and the factor."""
    scale = (truth[1] / solver.albedo).median(0).values
    return solver.light / scale, solver.albedo * scale, scale


def psnr(light, truth):
    """Return the PSNR of a light in dB relative to its brightest texel."""
    return float(-10 * ((light - truth).square().mean() / truth.max() ** 2).log10())


def test_albedo_is_found_up_to_one_factor(scene, found):
    _, albedo, scale = rescaled(found, scene[2])
    error = (albedo / scene[2][1] - 1).abs()
    assert error.median() < 0.01 and error.quantile(0.95) < 0.05 and error.max() < 0.15
    assert (scale - 1).abs().max() < 0.2  # even the factor is found, as metals and dielectrics share the light


def test_light_is_found(scene, found):
    light, _, _ = rescaled(found, scene[2])
    assert psnr(light, scene[2][0]) > 32
    assert (light.log() - scene[2][0].log()).abs().median() < 0.05


def test_gloss_is_found(scene, found):
    _, _, roughness, metallic = scene[2]
    assert torch.equal(found.metallic, metallic)
    assert (found.roughness - roughness).abs().max() < 0.05


def test_metal_is_found_only_where_it_is_looked_for(scene):
    transfer, seen, _ = scene
    solver = LightMaterialSolver(seen, transfer, torch.full((len(seen.position),), 0.5), torch.zeros(len(seen.position)), 0, False)
    run_solver(solver, on_step=lambda done: done == max(module.MATERIAL_STEPS[:2]) + 1)
    assert (solver.metallic == 0).all() and solver.roughness.std() > 0.05


def test_photographs_are_explained(scene, found):
    assert found.error() < 0.003
    transfer, seen, _ = scene
    assert found.error() < 0.1 * start(seen, transfer).error()


def test_without_knowing_what_is_in_the_way_albedo_is_wrong(scene, found):
    """With full visibility the albedo is wrong: the shadows are what determines it."""
    transfer, seen, truth = scene
    direction, angle, _, other = transfer.traced
    everything = (seen.normal.numpy() @ direction > 0).astype(np.float32)
    irradiance = (np.maximum(seen.normal.numpy() @ direction, 0) * angle / math.pi).reshape(-1, 4, TEXELS).sum(1)
    blind = RadianceTransfer(
        transfer.texels,
        TracedDirections(direction, angle, everything, 0 * other),
        torch.from_numpy(irradiance),
        0 * transfer.indirect,
        False,
    )
    errors = [(rescaled(s, truth)[1] / truth[1] - 1).abs().mean() for s in (found, solved(seen, blind))]
    assert errors[1] > 4 * errors[0]


def test_same_seed_same_bits(scene, found):
    transfer, seen, _ = scene
    again = solved(seen, transfer)
    for name in ("light", "albedo", "roughness", "metallic"):
        assert torch.equal(getattr(found, name), getattr(again, name)), name


def test_clipped_highlights_are_lower_bounds(scene):
    """Values marked as clipped do not dim the lamps."""
    transfer, seen, truth = scene
    clipped = replace(seen, colour=seen.colour.clamp_max(0.6), saturated=seen.colour > 0.6)
    assert 0.05 < clipped.saturated.float().mean() < 0.3
    marked, unmarked = (rescaled(solved(s, transfer), truth)[0] for s in (clipped, replace(clipped, saturated=seen.saturated)))
    assert psnr(marked, truth[0]) > psnr(unmarked, truth[0]) + 3
    brightest = truth[0] > 0.5 * truth[0].max()
    assert marked[brightest].mean() > 0.9 * truth[0][brightest].mean()
    assert unmarked[brightest].mean() < 0.9 * marked[brightest].mean()


def test_samples_that_do_not_fit_lose_their_weight(scene, found):
    """One sample in thirty has an unrelated colour."""
    transfer, seen, truth = scene
    wrong = torch.rand(len(seen.point), 1, generator=torch.Generator().manual_seed(0)) < 1 / 30
    other = torch.rand(seen.colour.shape, generator=torch.Generator().manual_seed(1))
    albedo = rescaled(solved(replace(seen, colour=torch.where(wrong, other, seen.colour)), transfer), truth)[1]
    error = (albedo / truth[1] - 1).abs()
    assert error.median() < 0.02 and error.quantile(0.9) < 0.1


def test_steps_are_reported_and_can_end_the_run(scene):
    transfer, seen, _ = scene
    reported = []
    solver = start(seen, transfer)
    run_solver(solver, on_step=lambda done: reported.append(done) or done == 2)
    assert reported == [1, 2]

    def stop(done):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_solver(start(seen, transfer), on_step=stop)
    assert max(module.MATERIAL_STEPS) + 1 < STEPS  # the light follows the materials


@pytest.mark.parametrize("moved, computed", [(0.0, 2), (1.0, 8)])
def test_the_hessian_is_kept_while_the_light_hardly_moves(scene, monkeypatch, moved, computed):
    """For MAX_HESSIAN_AGE steps then; it is computed anew in each step while the light moves, and where materials change."""
    transfer, seen, _ = scene
    monkeypatch.setattr(module, "robust_error", lambda *_: torch.zeros(1))  # it never rises
    solver, calls, original = start(seen, transfer), [], SampleRadiance.hessian
    monkeypatch.setattr(SampleRadiance, "hessian", lambda self, *args: calls.append(self) or original(self, *args))
    monkeypatch.setattr(LightMaterialSolver, "_moved", property(lambda self: moved, lambda self, value: None), raising=False)
    for done in range(2 * module.MAX_HESSIAN_AGE):
        solver.advance(done)
    assert len(calls) == computed and module.MATERIAL_STEPS[0] >= 2 * module.MAX_HESSIAN_AGE
    solver.advance(module.MATERIAL_STEPS[0])
    assert len(calls) == computed + 1 and calls[-1] is not calls[-2]


def test_the_hessian_is_computed_anew_where_the_error_rises(scene, monkeypatch):
    transfer, seen, _ = scene
    solver, steps, original = start(seen, transfer), [], SampleRadiance.hessian
    errors = iter((5.0, 4.0, 6.0, 5.0))
    monkeypatch.setattr(module, "robust_error", lambda *_: torch.full((1,), next(errors)))
    monkeypatch.setattr(SampleRadiance, "hessian", lambda self, *args: steps.append(done) or original(self, *args))
    monkeypatch.setattr(LightMaterialSolver, "_moved", property(lambda self: 0.0, lambda self, value: None), raising=False)
    for done in range(4):
        solver.advance(done)
    assert steps == [0, 2]


@pytest.mark.parametrize("error, kept", [(1e-4, True), (1e3, False)])
def test_tint_stays_with_the_light_only_where_the_photographs_tell(scene, monkeypatch, error, kept):
    """With a small error the fitted tint stays; with a large one the light becomes neutral and the albedo takes the tint."""
    transfer, seen, _ = scene
    monkeypatch.setattr(LightMaterialSolver, "reduce_tint", lambda self: None)
    solver = start(replace(seen, colour=seen.colour * torch.tensor([1.5, 1.0, 0.6])), transfer)
    run_solver(solver, on_step=lambda done: done == 6)
    monkeypatch.undo()
    before, product = solver._light_prior.tint(solver.light), solver.light.mean(0) * solver.albedo
    assert before.abs().max() > 0.2
    monkeypatch.setattr(solver, "error", lambda: error)
    solver.reduce_tint()
    after = solver._light_prior.tint(solver.light)
    assert torch.allclose(after, before, atol=0.02) if kept else after.abs().max() < 0.02
    assert torch.allclose(solver.light.mean(0) * solver.albedo, product, rtol=1e-4)


def test_a_lamp_smaller_than_a_texel_is_found_by_its_shadows(scene):
    """Split texels concentrate the light where the lamp is, so that the gloss need not explain how small it is."""
    position, normal = (part.numpy() for part in (scene[1].position, scene[1].normal))
    truth = LightTexels.uniform(HEIGHT)
    for last in (2 * 2 * HEIGHT + 5, truth.count + 23):  # a texel in the third row, 34 degrees above the floor; a part of it
        some = np.zeros(truth.count, bool)
        some[last - 7 : last + 1] = True  # whole vectors of 8, as the kernels need
        truth, _, _ = truth.split(some)
    light = torch.full((truth.count, 3), 0.3)
    light[-1] = 600.0
    exact = transport(position, normal, truth, 6)
    _, albedo, roughness, metallic = scene[2]
    seen = replace(scene[1], colour=rendered(scene[1], exact, light, albedo, roughness, 0 * metallic))

    def split(transfer, light):
        texels, _, old = transfer.texels.split(transfer.texels.brightest(light, 4 * HEIGHT, 8))
        return transport(position, normal, texels, 6), old

    errors = []
    for use in (None, split):
        gloss = (torch.full((len(position),), 0.5), torch.zeros(len(position)))
        found = LightMaterialSolver(seen, transport(position, normal, side=6), *gloss, 0, False)
        found = run_solver(found, use)
        errors.append(float((found.roughness - roughness).abs().mean()))
    assert errors[1] < 0.75 * errors[0]
    brightest = int(found.light[:, 0].argmax())
    texels = found.transfer.texels
    assert [int(part[brightest]) for part in (texels.level, texels.row, texels.column)] == [2, truth.row[-1], truth.column[-1]]
    assert float(found.light[brightest].mean()) > 0.5 * 600


@pytest.mark.parametrize("loss, whole", [(0.5, True), (2.0, False)])
def test_a_metal_object_is_metal_as_a_whole_unless_a_part_contradicts(scene, monkeypatch, loss, whole):
    """The error rises by a multiple of the evidence that is asked for where the rest is metal, too."""
    transfer, seen, _ = scene
    count = len(seen.position)
    solver = LightMaterialSolver(seen, transfer, torch.full((count,), 0.5), torch.zeros(count), 0)
    metal = torch.arange(count) > 0.1 * count
    errors = lambda points: torch.ones(count) * (1 + loss * MIN_REGION_GAIN * float(points.all()))  # noqa: E731
    monkeypatch.setattr(solver, "_adapted", lambda points: Hypothesis(points, solver, errors(points)))
    completed = completed_metal(metal, solver._adapted)
    assert torch.equal(completed, torch.ones_like(metal) if whole else metal)


def test_an_object_with_little_metal_keeps_its_other_parts(scene):
    transfer, seen, _ = scene
    count = len(seen.position)
    solver = LightMaterialSolver(seen, transfer, torch.full((count,), 0.5), torch.ones(count), 0)
    metal = torch.arange(count) < 0.4 * count
    assert torch.equal(completed_metal(metal, solver._adapted), metal)
