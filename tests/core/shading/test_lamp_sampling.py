# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of lamps follow their density, and their mean is the irradiance that formulas and quadrature give."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from irgspp.core.errors import InputError
from irgspp.core.scene.lamps import Lamp, lamp_records, read_lamps
from irgspp.core.shading.lamp_sampling import draw_lamp, has_extent, seen_lamp
from irgspp.core.shading.sampling import point_set

F64 = torch.float64
PLACE = np.array([[1, 0, 0, 0.6], [0, 0.8, 0.6, -0.4], [0, -0.6, 0.8, 2.5], [0, 0, 0, 1]], float)  # turned about X, right-handed
POINTS = torch.tensor([[0.0, 0.0, 0.0], [0.7, 0.2, -0.3], [-1.5, 0.4, 0.1]], dtype=F64)
WHERE = tuple(PLACE.reshape(-1).tolist())
LAMPS = {
    "sun": Lamp("sun", WHERE, (3.0, 2.0, 1.0), radius=0.2),
    "point": Lamp("point", WHERE, (30.0, 20.0, 10.0), radius=0.5),
    "facing point": Lamp("point", WHERE, (30.0, 20.0, 10.0), radius=0.5, sphere=False),
    "spot": Lamp("spot", WHERE, (30.0, 20.0, 10.0), radius=0.3, cone=0.6, blend=0.5),
    "rectangle": Lamp("area", WHERE, (9.0, 6.0, 3.0), size=(1.2, 0.5)),
    "ellipse": Lamp("area", WHERE, (9.0, 6.0, 3.0), size=(1.2, 0.5), ellipse=True, spread=0.9),
}
COUNT = 4096


def drawn(lamp, points=POINTS, count=COUNT):
    return draw_lamp(lamp, points, point_set(count)[None].expand(len(points), -1, -1))


@pytest.mark.parametrize("name", LAMPS)
def test_drawn_directions_meet_the_lamp_with_the_same_density(name):
    one = drawn(LAMPS[name])
    assert (one.density > 0).all() and torch.allclose(one.direction.norm(dim=-1), torch.ones(3, COUNT, dtype=F64))
    seen = seen_lamp(LAMPS[name], POINTS, one.direction)
    inside = seen.density > 0
    assert inside.double().mean() > 0.999  # all but samples on the very edge
    assert torch.allclose(seen.density[inside], one.density[inside], rtol=1e-6)
    assert torch.allclose(seen.distance[inside], one.distance[inside], rtol=1e-4)
    assert torch.allclose(seen.radiance[inside], one.radiance[inside], rtol=1e-4)


@pytest.mark.parametrize("name", LAMPS)
def test_samples_follow_their_density(name):
    """Over a grid of directions the density integrates to 1, and the samples' share of each cell of the grid is its integral."""
    lamp, rows = LAMPS[name], 1024
    z, phi = 1 - 2 * (torch.arange(rows, dtype=F64) + 0.5) / rows, 2 * math.pi * (torch.arange(2 * rows, dtype=F64) + 0.5) / (2 * rows)
    z, phi = torch.meshgrid(z, phi, indexing="ij")
    ring = (1 - z * z).sqrt()
    grid = torch.stack([ring * phi.cos(), ring * phi.sin(), z], -1).view(1, -1, 3)
    density = seen_lamp(lamp, POINTS[1:2], grid).density[0] * (4 * math.pi / (2 * rows * rows))
    assert float(density.sum()) == pytest.approx(1, abs=0.01)
    one = drawn(lamp, POINTS[1:2], 1 << 15).direction[0]
    middle = drawn(lamp, POINTS[1:2]).direction[0].mean(0)
    for axis in torch.eye(3, dtype=F64):  # half spaces through the lamp's middle
        side = torch.linalg.cross(middle, axis)
        expected = float(density[(grid[0] @ side) > 0].sum())
        assert float(((one @ side) > 0).double().mean()) == pytest.approx(expected, abs=0.01)


def irradiance(lamp, normal, count=COUNT):
    one = drawn(lamp, count=count)
    cosine = (one.direction @ normal).clamp_min(0)
    return (one.radiance * (cosine / one.density)[..., None]).mean(1)


def test_irradiance_of_spheres_and_suns():
    """E = I / d^2 and the given irradiance, at the cosine to the middle, for a lamp wholly above the horizon."""
    normal = torch.tensor([0.0, 0.0, 1.0], dtype=F64)
    to = torch.tensor(PLACE[:3, 3]) - POINTS
    distance = to.norm(dim=1, keepdim=True)
    intensity = torch.tensor([30.0, 20.0, 10.0], dtype=F64)
    expected = intensity / distance**2 * (to @ normal)[:, None] / distance
    for lamp in (LAMPS["point"], replace(LAMPS["point"], radius=0.0), replace(LAMPS["point"], radius=1e-3, sphere=False)):
        assert torch.allclose(irradiance(lamp, normal), expected, rtol=2e-3)
    towards = torch.tensor(PLACE[:3, 2])
    sun = torch.tensor([3.0, 2.0, 1.0], dtype=F64) * (towards @ normal)
    for lamp in (LAMPS["sun"], replace(LAMPS["sun"], radius=0.0)):
        assert torch.allclose(irradiance(lamp, normal), sun.expand(3, 3), rtol=2e-3)


def test_irradiance_of_a_rectangle():
    """The sum over a grid of small sources L cos cos dA / d^2."""
    lamp, normal = LAMPS["rectangle"], torch.tensor([0.0, 0.0, 1.0], dtype=F64)
    x, y = torch.meshgrid(*((torch.arange(200, dtype=F64) + 0.5) / 200 - 0.5 for _ in range(2)), indexing="ij")
    on = torch.stack([x * 1.2, y * 0.5, 0 * x, 1 + 0 * x], -1).view(-1, 4) @ torch.tensor(PLACE).T
    way = on[None, :, :3] - POINTS[:, None]
    d2 = (way**2).sum(-1)
    cosines = (way @ normal).clamp_min(0) * (way @ torch.tensor(PLACE[:3, 2])).clamp_min(0) / d2
    expected = (cosines / d2).sum(1) * (0.6 / 200**2)
    assert torch.allclose(irradiance(lamp, normal), expected[:, None] * torch.tensor([9.0, 6.0, 3.0], dtype=F64), rtol=2e-3)


def test_an_area_lamp_lights_one_side():
    behind = torch.tensor([[0.6, 2.0, 4.5]], dtype=F64)
    one = drawn(LAMPS["rectangle"], behind)
    assert not one.density.any() and not seen_lamp(LAMPS["rectangle"], behind, one.direction).density.any()


def test_a_spot_is_dark_outside_its_cone_and_full_on_its_axis():
    lamp = replace(LAMPS["spot"], radius=0.0)
    axis, place = torch.tensor(PLACE[:3, 2]), torch.tensor(PLACE[:3, 3])
    aside = torch.tensor(PLACE[:3, 0])
    points = torch.stack([place - 2 * axis, place - 2 * (math.cos(0.61) * axis + math.sin(0.61) * aside)])
    assert torch.allclose(drawn(lamp, points, 1).radiance[:, 0, 0], torch.tensor([30 / 4, 0.0], dtype=F64))


@pytest.mark.parametrize("name", LAMPS)
def test_light_does_not_depend_on_the_frame(name):
    """A lamp moved, turned and scaled together with the points gives the same irradiance."""
    angle = 0.7
    turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = 2.5 * turn, (1.0, -2.0, 0.5)
    moved = POINTS @ torch.tensor(step[:3, :3]).T + torch.tensor(step[:3, 3])
    normal = torch.tensor([0.3, 0.1, 0.95], dtype=F64)
    one, other = drawn(LAMPS[name]), drawn(LAMPS[name].moved(step), moved)
    before = (one.radiance * ((one.direction @ normal).clamp_min(0) / one.density)[..., None]).mean(1)
    after = (other.radiance * ((other.direction @ (torch.tensor(turn) @ normal)).clamp_min(0) / other.density)[..., None]).mean(1)
    assert torch.allclose(before, after, rtol=2e-3)


def test_suns_narrower_than_rounding_count_as_sharp():
    assert not has_extent(replace(LAMPS["sun"], radius=1e-4)) and has_extent(replace(LAMPS["sun"], radius=0.0046))


def test_records():
    lamps = tuple(LAMPS.values())
    assert read_lamps(lamp_records(lamps)) == lamps
    assert read_lamps([{"kind": "sun"}]) == (Lamp("sun"),)


@pytest.mark.parametrize(
    "values",
    [
        {"kind": "sun"},
        [{"kind": "torch"}],
        [{}],
        [{"kind": "sun", "colour": 1}],
        [{"kind": "point", "emission": [1, 1]}],
        [{"kind": "point", "emission": [1, 1, -1]}],
        [{"kind": "point", "radius": "nan"}],
        [{"kind": "area"}],
        [{"kind": "spot", "blend": 2}],
        [{"kind": "sun", "radius": 3}],
        [{"kind": "point", "to_world": [0] * 16}],
        [{"kind": "point", "to_world": None}],
    ],
)
def test_broken_lamps_are_one_line(values):
    with pytest.raises(InputError, match=r"^lamp"):
        read_lamps(values)
