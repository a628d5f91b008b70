# SPDX-License-Identifier: GPL-3.0-or-later
"""BRDF of the baseline: its published peaks, and agreement with this program's where neither bounds anything."""

import math

import pytest
import torch
from irgspp.core.shading.rendering_equation import reflect_light
from irgspp.core.shading.sampling import Samples
from irgspp.core.stages.second.joint.irgs import reflect_as_irgs

UP = torch.tensor([[0.0, 0.0, 1.0]])


def reflected(roughness, direction, view=UP, albedo=0.0, brdf=reflect_as_irgs, **options):
    """Light of one sample of radiance 1 and density 1."""
    samples = Samples(direction[:, None], torch.ones(1, 1))
    materials = torch.full((1, 3), albedo), torch.tensor([roughness]), torch.zeros(1)
    diffuse, specular = brdf(view, UP, *materials, samples, torch.ones(1, 1, 3), **options)
    return float(diffuse[0, 0]), float(specular[0, 0])


@pytest.mark.parametrize(("roughness", "peak"), [(0.1, 4.0), (0.05, 0.25), (0.5, 0.04 / (4 * math.pi * 0.5**4))])
def test_sharp_lobes_are_capped(roughness, peak):
    assert reflected(roughness, UP)[1] == pytest.approx(peak, rel=1e-2)


def test_diffuse_light_is_lambert_s():
    slanted = torch.nn.functional.normalize(torch.tensor([[1.0, 0.0, 1.0]]), dim=1)
    assert reflected(0.7, slanted, albedo=0.6)[0] == pytest.approx(0.6 / math.pi * math.sqrt(0.5), rel=1e-5)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 0.9])
def test_lobes_agree_with_ours_up_to_the_masking(roughness):
    mirror = torch.nn.functional.normalize(torch.tensor([[0.5, 0.0, 1.0]]), dim=1)
    view = mirror * torch.tensor([-1.0, 1.0, 1.0])
    ours = reflected(roughness, mirror, view, brdf=reflect_light)[1]
    assert reflected(roughness, mirror, view)[1] == pytest.approx(ours, rel=0.25)
