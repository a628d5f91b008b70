# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of sampling: independent samples of one point, a chi-square test against their density, and light maps to sample."""

import math

import torch
from irgspp.core.shading.sampling import draw
from scipy.stats import chi2

F64 = torch.float64
NORMAL = torch.nn.functional.normalize(torch.tensor([-0.6, 0.5, -0.4], dtype=F64), dim=0)
COUNT = 200_000


def unit(*values):
    return torch.nn.functional.normalize(torch.tensor(values, dtype=F64), dim=-1)


def local_frame(normal=NORMAL):
    """Return a right-handed frame (3, 3) about a normal (3,), tangents and normal as columns, by cross products."""
    tangent = torch.nn.functional.normalize(torch.linalg.cross(unit(0.1, 0.9, 0.3), normal), dim=0)
    return torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], -1)


def tilted_view(degrees):
    """Return a unit view direction (3,) at this angle from NORMAL."""
    angle = math.radians(degrees)
    return local_frame() @ torch.tensor([math.sin(angle) * 0.6, math.sin(angle) * 0.8, math.cos(angle)], dtype=F64)


def one_sample_each(view, normal, roughness, counts, light, seed=1, dtype=torch.float32):
    """Return directions (COUNT, 3) and densities (COUNT,) of one sample at each of COUNT identical points, which are independent."""
    view, normal = (t.to(dtype).expand(COUNT, 3) for t in (view, normal))
    samples = draw(view, normal, torch.full((COUNT,), roughness, dtype=dtype), counts, light, torch.Generator().manual_seed(seed))
    return samples.direction[:, 0].double(), samples.density[:, 0].double()


def assert_follows(cells, probability):
    """Test cell numbers (COUNT,) against the cells' probabilities (K,) by chi-square; cells with few expected samples are merged."""
    expected = probability * len(cells)
    observed = torch.bincount(cells, minlength=len(expected)).double()
    big = expected > 10
    pairs = [(observed[big], expected[big]), (observed[~big].sum()[None], expected[~big].sum()[None])]
    statistic = sum(((o - e) ** 2 / e.clamp_min(1e-9)).sum().item() for o, e in pairs if e.sum() > 3)
    assert observed[~big].sum() < 3 * expected[~big].sum() + 30
    assert statistic < chi2.ppf(1 - 1e-4, max(int(big.sum()), 1))


def hot_texel(row, column):
    """Return a black light map (16, 32, 3) with one bright texel."""
    light = torch.zeros(16, 32, 3)
    light[row, column, 1] = 1000.0
    return light


LIGHT_MAPS = {
    "constant": torch.full((16, 32, 3), 0.3),
    "random": torch.rand(16, 32, 3, generator=torch.Generator().manual_seed(0)) ** 4,
    "black": torch.zeros(16, 32, 3),
    "hot pole": hot_texel(0, 5),
    "hot seam": hot_texel(9, 31),
    "hot middle": hot_texel(7, 12),
    "odd size": torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(1)),
}
