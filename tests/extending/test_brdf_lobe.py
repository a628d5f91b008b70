# SPDX-License-Identifier: GPL-3.0-or-later
"""Example of docs/architecture.md, "to add a BRDF lobe": a sheen for cloth (Estevez and Kulla 2017), estimated by the existing sampling."""

import math

import pytest
import torch
from irgspp.core.shading.light_distribution import LightDistribution
from irgspp.core.shading.sampling import draw

# --- core/shading/brdf.py: the formula


def sheen_lobe(view, normal, roughness, direction):
    """Evaluate f cos of the sheen for N directions at each of P points.

    D = (2 + 1/a) sin^(1/a) / (2 pi), V = 1 / (4 (n.l + n.v - n.l n.v)) (Neubelt and Pettineo 2013), a = roughness.

    Args:
        view, normal: (P, 3) unit.
        roughness: (P,) in (0, 1].
        direction: (P, N, 3) unit.

    Returns: (P, N), 0 below the horizon.
    """
    n_l = torch.einsum("pnc,pc->pn", direction, normal)
    n_v = (view * normal).sum(-1)[:, None]
    half = torch.nn.functional.normalize(direction + view[:, None], dim=-1)
    sine2 = (1 - torch.einsum("pnc,pc->pn", half, normal) ** 2).clamp_min(0)
    inverse = 1 / roughness[:, None]
    density = (2 + inverse) * sine2 ** (0.5 * inverse) / (2 * math.pi)
    value = density / (4 * (n_l + n_v - n_l * n_v)).clamp_min(1e-6)
    return torch.where(n_l > 0, value * n_l, 0.0)


# --- tests: reciprocity, energy, the Monte Carlo estimate against quadrature


def point(cosine, roughness):
    view = torch.tensor([[math.sqrt(1 - cosine**2), 0.0, cosine]], dtype=torch.float64)
    return view, torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64), torch.tensor([roughness], dtype=torch.float64)


def quadrature(view, normal, roughness, count=400):
    """Reflected fraction of a white sky, by the midpoint rule over the hemisphere."""
    z, phi = (torch.arange(count) + 0.5) / count, (torch.arange(count) + 0.5) / count * 2 * math.pi
    z, phi = (x.flatten() for x in torch.meshgrid(z.double(), phi.double(), indexing="ij"))
    r = (1 - z * z).sqrt()
    direction = torch.stack([r * phi.cos(), r * phi.sin(), z], -1)[None]
    return sheen_lobe(view, normal, roughness, direction).mean() * 2 * math.pi


def test_reciprocal():
    view, normal, roughness = point(0.3, 0.5)
    other, _, _ = point(0.8, 0.5)
    there = sheen_lobe(view, normal, roughness, other[:, None]) / 0.8
    back = sheen_lobe(other, normal, roughness, view[:, None]) / 0.3
    assert torch.allclose(there, back)


@pytest.mark.parametrize("cosine", [0.1, 0.5, 0.95])
@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
def test_no_energy_is_made(cosine, roughness):
    assert 0 < quadrature(*point(cosine, roughness)) < 1


@pytest.mark.parametrize("cosine", [0.3, 0.9])
def test_samples_of_the_existing_strategies_serve_it(cosine):
    view, normal, roughness = point(cosine, 0.5)
    light = LightDistribution(torch.ones(8, 16, 3, dtype=torch.float64))
    samples = draw(view, normal, roughness, (256, 64, 64), light, torch.Generator().manual_seed(0))
    estimate = (sheen_lobe(view, normal, roughness, samples.direction) / samples.density).mean()
    assert abs(estimate / quadrature(view, normal, roughness) - 1) < 0.03
