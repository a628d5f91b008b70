# SPDX-License-Identifier: GPL-3.0-or-later
"""Degenerate Gaussians, without area, opacity or orientation: results and gradients stay finite."""

import math

import pytest
import torch
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.kernels.trace import build_tree, hit_lists, trace, transmittance
from irgspp.core.scene.camera import Camera, look_at

COUNT, BROKEN = 40, 9  # Gaussians, and how many of them are degenerate
pytestmark = pytest.mark.usefixtures("engine")
CAMERA = Camera(32, 32, 42.0, 42.0, 16.0, 16.0, look_at((3.0, 1.0, 2.0)))
INVISIBLE = {  # faults that make a Gaussian invisible to rays
    "no area": ("log_scale", slice(None), -1e30),
    "no width": ("log_scale", slice(0, 1), -1e30),
    "area below float32": ("log_scale", slice(None), -100.0),
    "no opacity": ("opacity", slice(None), -1e30),
    "opacity below float32": ("opacity", slice(None), -200.0),
}
UNUSUAL = {
    "no orientation": ("quaternion", slice(None), 0.0),
    "huge": ("log_scale", slice(None), 1e30),
    "far": ("position", slice(0, 1), 1e9),
}


def gaussians(broken=None) -> dict[str, torch.Tensor]:
    """Return a cloud of Gaussians; `broken`: parameter, rows and the value that the first BROKEN Gaussians get."""
    g = torch.Generator().manual_seed(3)
    shapes = {"position": (3,), "quaternion": (4,), "log_scale": (2,), "opacity": (), "sh": (16, 3), "extra": (2,)}
    values = {name: torch.randn(*shape, COUNT, generator=g) for name, shape in shapes.items()}
    values["position"] *= 0.4
    values["log_scale"] = values["log_scale"] * 0.3 - 1.6
    if broken is not None:
        name, rows, value = broken
        values[name].view(-1, COUNT)[rows, :BROKEN] = value
    return {name: value.requires_grad_() for name, value in values.items()}


def rays() -> tuple[torch.Tensor, torch.Tensor]:
    directions = torch.nn.functional.normalize(torch.from_numpy(CAMERA.rays()).reshape(-1, 3), dim=-1)
    return torch.tensor(CAMERA.centre, dtype=torch.float32).expand_as(directions).contiguous(), directions


def traced(values: dict[str, torch.Tensor]):
    tree = build_tree(*(values[name] for name in ("position", "quaternion", "log_scale", "opacity")))
    return trace(*values.values(), *rays(), tree), tree


def assert_finite(values: dict[str, torch.Tensor], sums: torch.Tensor) -> None:
    assert sums.isfinite().all() and sums.any()
    sums.square().sum().backward()
    for name, value in values.items():
        assert value.grad is not None and value.grad.isfinite().all(), name


@pytest.mark.parametrize("broken", [*INVISIBLE.values(), *UNUSUAL.values()], ids=[*INVISIBLE, *UNUSUAL])
def test_images_and_gradients_are_finite(broken):
    values = gaussians(broken)
    assert_finite(values, rasterize(*values.values(), CAMERA, 1.0)[0])


@pytest.mark.parametrize("broken", [*INVISIBLE.values(), *UNUSUAL.values()], ids=[*INVISIBLE, *UNUSUAL])
def test_traced_sums_and_gradients_are_finite(broken):
    values = gaussians(broken)
    sums, tree = traced(values)
    assert_finite(values, sums)
    assert transmittance(tree, *rays()).isfinite().all()


@pytest.mark.parametrize("broken", INVISIBLE.values(), ids=INVISIBLE)
def test_invisible_gaussians_do_not_change_rays(broken):
    sums, tree = traced(gaussians(broken))
    assert hit_lists(tree, *rays()).index.min() >= BROKEN
    rest, _ = traced({name: value.detach()[..., BROKEN:].contiguous().requires_grad_() for name, value in gaussians().items()})
    assert torch.equal(sums, rest)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["position", "quaternion", "log_scale", "opacity"])
def test_the_tree_leaves_out_gaussians_that_are_not_finite(name, value):
    """An infinite opacity logit counts as opacity 1; all other non-finite Gaussians are left out."""
    sums, tree = traced(gaussians((name, slice(0, 1), value)))
    assert sums.isfinite().all()
    assert (name == "opacity" and value == math.inf) or hit_lists(tree, *rays()).index.min() >= BROKEN
