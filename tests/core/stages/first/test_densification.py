# SPDX-License-Identifier: GPL-3.0-or-later
"""Density control: which Gaussians are pruned, cloned and split, within the budget."""

import math

import pytest
import torch
from irgspp.core.errors import IrgsppError
from irgspp.core.kernels.rasterize import ScreenStatistics
from irgspp.core.progress.protocol import Silent
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import preset
from irgspp.core.stages.common.optimizer import GaussianOptimizer, Rate
from irgspp.core.stages.first.densification import (
    PRUNE_OPACITY,
    RESET_OPACITY,
    SPLIT_SHRINK,
    DensityControl,
    require_surfels,
    reset_opacity,
)
from irgspp.core.stages.first.train import train

COUNT = 200
RATES = {"position": Rate(1e-3), "opacity": Rate(1e-2)}


@pytest.fixture
def gaussians(some_gaussians):
    g = some_gaussians(COUNT, 3)
    g.log_scale = torch.full((2, COUNT), math.log(0.005))
    g.opacity = torch.full((COUNT,), 2.0)
    return g


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(0)


def accumulated(control, gradient):
    control.accumulate(ScreenStatistics(torch.ones(len(gradient)), gradient))


def test_exactly_the_transparent_the_huge_and_the_unseen_go(gaussians, generator):
    gaussians.opacity[:10] = math.log(PRUNE_OPACITY / (1 - PRUNE_OPACITY)) - 0.01
    gaussians.log_scale[1, 10:15] = math.log(0.51)
    gradient = torch.ones(COUNT)
    gradient[15:40] = 0
    control, optimizer = DensityControl(1000, 1.0), GaussianOptimizer(gaussians, RATES)
    accumulated(control, gradient)
    assert control.refine(optimizer, generator, grow=False) == (0, 40)
    assert torch.equal(optimizer.gaussians.position, gaussians.position[:, 40:])
    assert torch.equal(optimizer.gaussians.sh, gaussians.sh[..., 40:])


def test_no_gaussian_left_is_an_error(gaussians, generator):
    control, optimizer = DensityControl(1000, 1.0), GaussianOptimizer(gaussians, RATES)
    accumulated(control, torch.zeros(COUNT))
    with pytest.raises(IrgsppError, match="no Gaussian is left"):
        control.refine(optimizer, generator, grow=False)
    assert optimizer.gaussians.count == COUNT


def test_once_seen_is_seen(gaussians, generator):
    control, optimizer = DensityControl(1000, 1.0), GaussianOptimizer(gaussians, RATES)
    for half in (0, 1):
        accumulated(control, (torch.arange(COUNT) % 2 == half).float())
    assert control.refine(optimizer, generator, grow=False) == (0, 0)


@pytest.mark.parametrize("spare", [0, 7, 1000])
def test_the_hardest_pulled_are_cloned_within_the_budget(gaussians, generator, spare):
    gradient = torch.linspace(0.1, 1, COUNT)
    control, optimizer = DensityControl(COUNT + spare, 1.0), GaussianOptimizer(gaussians, RATES)
    accumulated(control, gradient)
    added, pruned = control.refine(optimizer, generator, grow=True)
    assert (added, pruned) == (min(spare, math.ceil(control.grow * COUNT)), 0)
    position = optimizer.gaussians.position
    assert torch.equal(position[:, :COUNT], gaussians.position)
    assert torch.equal(position[:, COUNT:], gaussians.position[:, COUNT - added :])


def test_split_surfels_stay_in_their_place_and_plane(gaussians, generator):
    gaussians.log_scale = torch.tensor([[0.03], [0.05]]).log().repeat(1, COUNT)
    control, optimizer = DensityControl(10 * COUNT, 1.0, grow=1.0), GaussianOptimizer(gaussians, RATES)
    accumulated(control, torch.ones(COUNT))
    assert control.refine(optimizer, generator, grow=True) == (COUNT, 0)
    g = optimizer.gaussians
    assert g.count == 2 * COUNT
    offset = g.position.detach() - gaussians.position.repeat(1, 2)
    height = (offset * gaussians.normals().repeat(1, 2)).sum(0)
    assert height.abs().max() < 1e-5
    assert 0.5 < offset.norm(dim=0).square().mean() / (0.03**2 + 0.05**2) < 1.5  # drawn from the surfel's own distribution
    assert offset.mean(1).norm() < 0.01
    assert torch.allclose(g.log_scale, gaussians.log_scale.repeat(1, 2) - math.log(SPLIT_SHRINK))


def test_statistics_start_anew_with_another_set(gaussians, generator):
    control, optimizer = DensityControl(COUNT + 5, 1.0), GaussianOptimizer(gaussians, RATES)
    accumulated(control, torch.ones(COUNT))
    control.refine(optimizer, generator, grow=True)
    accumulated(control, torch.ones(COUNT + 5))
    assert control.seen.tolist() == [1.0] * (COUNT + 5)


def test_opacity_is_capped_and_its_moments_forgotten(gaussians):
    gaussians.opacity[:5] = -6.0
    optimizer = GaussianOptimizer(gaussians, RATES)
    optimizer.leaves["opacity"].grad = torch.ones(COUNT)
    optimizer.leaves["position"].grad = torch.ones(3, COUNT)
    optimizer.step(0.0)
    low = optimizer.leaves["opacity"].detach()[:5].clone()
    reset_opacity(optimizer)
    opacity = optimizer.gaussians.opacity.detach()
    assert torch.allclose(opacity.sigmoid()[5:], torch.tensor(RESET_OPACITY), atol=1e-6)
    assert torch.equal(opacity[:5], low)
    moments = optimizer.state()["moments"]
    assert not moments["opacity.exp_avg"].any() and moments["position.exp_avg"].all()


def test_a_hull_that_falls_apart_is_one_clear_line():
    require_surfels(170, 400, 7)
    with pytest.raises(IrgsppError, match="only 150 of 400 surfels that the fit started with are left at iteration 7"):
        require_surfels(150, 400, 7)


@pytest.mark.parametrize(("choice", "least", "most"), [("on", 250, 400), ("auto", 380, 400), ("off", 380, 400)])
def test_density_control_adds_surfels_to_a_hull_where_the_settings_ask_for_it(sphere_dataset, camera_ring, choice, least, most):
    """On: the fit starts with half of the 400, and grows; else a hull has all from the start."""
    dataset, starts = sphere_dataset(camera_ring(9, 32)), []

    class Watcher(Silent):
        def shape(self, sample, at_once=False):
            starts.append(len(sample()["position"]))

    few = "materials=low-gloss", "first.stereo=off", "first.open_edges=0", "first.light_height=16"
    sizes = "first.iterations=100", "first.gaussians=400"
    chosen = with_overrides(preset("draft"), [*few, *sizes, f"first.densification={choice}"])
    fitted, _ = train(dataset, chosen, Watcher())
    assert starts[0] == (200 if choice == "on" else 400)
    assert least <= fitted.gaussians.count <= most
