# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours as evidence for metal: gold among green skin, metals of two colours, few members, and compared with a plain double loop."""

import math

import pytest
import torch
from irgspp.core.stages.second.metal import DARKEST, TINT_WIDTH
from irgspp.core.stages.second.solver.metal_colours import DARK_METAL, DARK_SHARE, FLOOR, colour_evidence, too_dark

GOLD, COPPER, SKIN = (1.0, 0.77, 0.34), (0.95, 0.64, 0.54), (0.4, 0.45, 0.25)


def points(colours, seed=0):
    """Points of colours that differ a little in tint, and much in brightness."""
    generator = torch.Generator().manual_seed(seed)
    base = torch.tensor(colours)
    return base * torch.exp(0.05 * torch.randn(base.shape, generator=generator) + 0.3 * torch.randn(len(base), 1, generator=generator))


def test_gold_among_skin():
    """Skin that counts as metal has another tint as metal than the gold, and that of all skin as a dielectric."""
    as_metal = points([GOLD] * 40 + [(0.85, 0.9, 0.6)] * 60)
    as_dielectric = points([(1.0, 0.6, 0.5)] * 40 + [SKIN] * 60, 1)
    metal = torch.arange(100) < 50  # ten points of skin among them
    evidence = colour_evidence(as_metal, as_dielectric, metal)
    assert float(evidence[:40].min()) > 1.5
    assert float(evidence[40:].max()) < 0.5


def test_metals_of_two_colours_both_count():
    as_metal = points([GOLD] * 30 + [COPPER] * 30 + [(0.3, 0.5, 0.9)] * 30)
    evidence = colour_evidence(as_metal, points([SKIN] * 90, 1), torch.arange(90) < 60)
    assert float(evidence[:60].min()) > float(evidence[60:].max())


def test_rubber_beside_chrome_is_too_dark():
    chrome, rubber = torch.full((40, 3), 0.7), torch.full((60, 3), 0.11)
    as_metal = torch.cat([chrome, rubber])
    assert torch.equal(too_dark(as_metal, torch.arange(100) < 50), torch.arange(100) >= 40)  # ten points of rubber count as metal


def test_an_object_of_dark_metal_alone_is_not_too_dark():
    dark = torch.full((50, 3), 0.5 * DARK_METAL)
    assert not too_dark(dark, torch.ones(50, dtype=torch.bool)).any()
    dark[0] *= 0.9 * DARK_SHARE
    assert torch.equal(torch.nonzero(too_dark(dark, torch.ones(50, dtype=torch.bool)))[:, 0], torch.tensor([0]))


def test_a_point_is_no_evidence_for_itself():
    evidence = colour_evidence(torch.tensor([GOLD, COPPER]), torch.tensor([SKIN, SKIN]), torch.tensor([True, False]))
    assert float(evidence[0]) == pytest.approx(math.log(FLOOR) - math.log(1 + FLOOR), abs=1e-5)  # the skin is like the other point's
    assert torch.isfinite(evidence).all()


def test_densities_by_a_plain_double_loop():
    generator = torch.Generator().manual_seed(3)
    as_metal, as_dielectric = 1.2 * torch.rand(2, 12, 3, generator=generator) - 0.05  # fits may lie outside 0..1
    metal = torch.rand(12, generator=generator) < 0.5

    def density(albedo, p, members):
        log = albedo.double().clamp_min(DARKEST).log()
        tint = [(float(a[0] - a[1]), float(a[2] - a[1])) for a in log]
        others = [q for q in members if q != p]
        return sum(math.exp(-0.5 * (math.dist(tint[p], tint[q]) / TINT_WIDTH) ** 2) for q in others) / max(len(others), 1)

    inside, outside = ([q for q in range(12) if bool(metal[q]) == one] for one in (True, False))
    found = colour_evidence(as_metal, as_dielectric, metal)
    for p in range(12):
        expected = math.log(density(as_metal, p, inside) + FLOOR) - math.log(density(as_dielectric, p, outside) + FLOOR)
        assert float(found[p]) == pytest.approx(expected, abs=1e-4)
