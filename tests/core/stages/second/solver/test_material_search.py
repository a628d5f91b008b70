# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials by grid search under the true light, on the sphere on a floor."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.stages.second.solver import metal_cut
from irgspp.core.stages.second.solver.material_search import METAL_ROUGHNESS_COUNT, MaterialSearch
from irgspp.core.stages.second.solver.metal_colours import DARK_METAL
from irgspp.core.stages.second.solver.sample_equation import approximate_srgb_derivative
from sphere_on_floor import make


@pytest.fixture(scope="module")
def searched():
    """A search, its costs under the true light, and the true albedo, roughness and metallic."""
    transfer, seen, (light, *truth) = make()
    search = search_of(seen, transfer)
    return search, costs(search, light), truth


def search_of(seen, transfer, metals=True):
    return MaterialSearch(seen, transfer, transfer.diffuse_rows(seen), seen.sums(seen.colour) / seen.lengths[:, None], metals)


def costs(search, light):
    derivative = approximate_srgb_derivative(search.samples.colour)
    return search.costs(light, derivative**2, derivative)


def test_true_materials_cost_least(searched):
    search, cost, (_, roughness, metallic) = searched
    metal = metallic > 0
    assert torch.equal(cost[:, 1, :METAL_ROUGHNESS_COUNT].amin(1) < cost[:, 0].amin(1), metal)
    assert (search.roughness(cost, metal) - roughness).abs().max() < 0.06


def test_the_prior_leaves_clear_evidence_and_metal_alone(searched):
    search, cost, (albedo, roughness, metallic) = searched
    metal = metallic > 0
    found = search.likely_roughness(cost, metal, albedo)
    assert torch.equal(found[metal], search.roughness(cost, metal)[metal])
    assert (found - roughness).abs().max() < 0.06


def test_the_prior_fills_in_a_roughness_that_nothing_shows(searched):
    search, cost, (albedo, roughness, metallic) = searched
    metal, hidden = metallic > 0, torch.zeros(len(albedo), dtype=torch.bool)
    hidden[torch.nonzero(metallic == 0)[::20]] = True
    flat = torch.where(hidden[:, None, None], cost.amin(2, keepdim=True) * (1 + 1e-3 * torch.arange(cost.shape[2]).flip(0)), cost)
    assert (search.roughness(flat, metal) - roughness)[hidden].abs().min() > 0.1  # all of them too rough
    assert (search.likely_roughness(flat, metal, albedo) - roughness)[hidden].abs().max() < 0.06


def redrawn(search, cost, metal):
    """Redraw the borders under the light of `make`."""
    return search.redrawn_metal(cost, metal, make()[2][0], torch.ones_like(search.samples.colour))


def grown(search, cost, metal):
    """Redraw the borders by searched normals and colours under the light of `make`."""
    return search.grown_metal(cost, metal, make()[2][0], torch.ones_like(search.samples.colour), search.samples.normal)


def test_candidates_are_the_metal_and_stay(searched):
    search, cost, (_, _, metallic) = searched
    metal = metallic > 0
    assert torch.equal(search.metal_candidates(cost), metal)
    assert torch.equal(redrawn(search, cost, torch.ones_like(metal)), metal)  # the others are contradicted
    assert not redrawn(search, cost, torch.zeros_like(metal)).any()


@pytest.mark.parametrize("borders", [redrawn, grown])
def test_what_would_be_dark_metal_stays_outside_its_borders(searched, borders):
    search, cost, (albedo, _, metallic) = searched
    metal, dark = metallic > 0, 0.05
    height = search.samples.position[:, 2]
    rubber = metal & (height < height[metal].median())
    assert float(albedo[metal].mean(1).min()) > DARK_METAL > dark
    darkened, colour = copy.copy(search), search.samples.colour
    darkened.samples = replace(search.samples, colour=torch.where(rubber[search.samples.point, None], dark * colour, colour))
    assert torch.equal(borders(darkened, cost, metal), metal & ~rubber)


def test_colours_of_metal_are_told_from_those_of_the_rest(searched):
    """Half of the metal sphere counts as metal."""
    search, cost, (_, _, metallic) = searched
    metal, height = metallic > 0, search.samples.position[:, 2]
    half = metal & (height > height[metal].median())
    evidence, dark = search.metal_colours(cost, half, make()[2][0], torch.ones_like(search.samples.colour))
    assert evidence[metal & ~half].mean() > 1 and evidence[~metal].mean() < -1
    assert not dark[metal].any()


def test_metal_that_is_far_from_the_metal_found_is_told_by_its_colours(searched, monkeypatch):
    """The test of regions found the top of the metal sphere alone; as the sphere has few points, less is near."""
    monkeypatch.setattr(metal_cut, "MAX_RINGS", 1)
    search, cost, (_, _, metallic) = searched
    metal, height = metallic > 0, search.samples.position[:, 2]
    top = metal & (height > height[metal].quantile(0.9))
    assert float(redrawn(search, cost, top)[metal].float().mean()) < 0.8  # the rest is out of reach
    assert torch.equal(grown(search, cost, top), metal)


def test_costs_of_metals_are_left_out_where_there_are_none(searched):
    _, cost, _ = searched
    transfer, seen, (light, *_) = make()
    alone = costs(search_of(seen, transfer, False), light)
    np.testing.assert_allclose(alone, cost[:, :1], rtol=1e-5)


def test_candidates_stay_where_metal_explains_the_photographs_better(searched):
    search, _, (_, _, metallic) = searched
    metal, views = metallic > 0, search.samples.lengths.float().mean()
    everything, gain = torch.ones_like(metal), torch.where(metal, 1.0, -1.0) * views
    kept = search.supported(everything, gain)
    assert torch.equal(kept, metal)  # neighbours of another colour hardly count
    assert not search.supported(~metal, gain).any()  # only candidates can stay
    one = gain.clone()
    one[torch.nonzero(metal)[0]] = -0.2 * views
    assert torch.equal(search.supported(everything, one), metal)  # a single doubtful point does not leave its region
