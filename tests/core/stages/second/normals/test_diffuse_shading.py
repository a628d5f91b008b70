# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffuse shading: irradiance as a function of the normal, and the mean radiance of views without gloss."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from irgspp.core.kernels.lobes import TracedDirections
from irgspp.core.scene.spherical_harmonics import sh_basis
from irgspp.core.stages.second.normals.diffuse_shading import mean_diffuse_radiance, point_irradiance
from irgspp.core.stages.second.solver.light_texels import LightTexels
from irgspp.core.stages.second.solver.multi_view_samples import MultiViewSamples
from irgspp.core.stages.second.solver.radiance_transfer import RadianceTransfer

HEIGHT = 8


def solver(normal: torch.Tensor, light: torch.Tensor, shadow: float) -> SimpleNamespace:
    """Return what is read of a solver whose points (P, 3) get `shadow` of the light (T, 3) from all directions."""
    texels = LightTexels.uniform(HEIGHT)
    direction, angle = (torch.from_numpy(array) for array in texels.directions(2, 0))
    visible = torch.full((len(normal), len(angle)), shadow)
    weight = (normal @ direction).clamp_min(0) * angle / math.pi * visible
    rows = weight.view(len(normal), 4, len(light)).sum(1)
    incoming = torch.zeros(len(normal), 3, len(angle))
    transfer = RadianceTransfer(texels, TracedDirections(direction, angle, visible, incoming), rows, torch.zeros(len(normal), 3), False)
    return SimpleNamespace(
        transfer=transfer, light=light, light_map=lambda height: texels.map(light, height), samples=SimpleNamespace(normal=normal)
    )


def random_normals(count: int) -> torch.Tensor:
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(0)), dim=1)


def test_the_irradiance_is_exact_at_the_own_normal_and_close_at_others():
    light = torch.rand(2 * HEIGHT**2, 3, generator=torch.Generator().manual_seed(1)) + 0.5
    given = solver(random_normals(20), light, 0.5)
    harmonics, irradiance_fraction = point_irradiance(given)
    own = np.einsum("kp,pkc->pc", sh_basis(given.samples.normal.T.double(), 2).numpy(), harmonics)
    assert own == pytest.approx((given.transfer.irradiance @ light).numpy(), rel=1e-4)
    assert irradiance_fraction.numpy() == pytest.approx(0.5, rel=1e-4)
    other = -given.samples.normal
    seen = np.einsum("kp,pkc->pc", sh_basis(other.T.double(), 2).numpy(), harmonics)
    assert seen == pytest.approx((solver(other, light, 0.5).transfer.irradiance @ light).numpy(), rel=0.15)


def test_the_mean_leaves_out_gloss_and_the_odd_view():
    normal = torch.tensor([[0.0, 0.0, 1.0]])
    view = torch.nn.functional.normalize(torch.tensor([[0.1, 0, 1], [-0.1, 0, 1], [0, 0.2, 1], [0, -0.2, 1]]), dim=1)
    dark = solver(normal, torch.full((2 * HEIGHT**2, 3), 1e-6), 1.0)
    lit = solver(normal, torch.full((2 * HEIGHT**2, 3), 1.0), 1.0)
    colour = torch.full((4, 3), 0.4)
    colour[3] = 0.9
    samples = MultiViewSamples(normal, normal, torch.zeros(4, dtype=torch.int64), view, colour, colour > 1)
    materials = torch.tensor([[0.5, 0.0, 1.0]])
    without, certain = mean_diffuse_radiance(samples, dark, materials)
    less, _ = mean_diffuse_radiance(samples, lit, materials)
    assert np.exp(without) == pytest.approx(0.4, rel=0.12)  # over what the coat leaves
    assert ((np.exp(without) - np.exp(less) > 0.02) & (np.exp(without) - np.exp(less) < 0.08)).all()
    assert 0 < certain[0] < 1 / 0.03**2
