# SPDX-License-Identifier: GPL-3.0-or-later
"""The denoiser on synthetic surfaces: constants and edges remain, noise is removed."""

import dataclasses

import numpy as np
import pytest
import torch
from irgspp.core.relight.denoise import IMAGE, SPECULAR, Filter, Guides, corrected_reference, denoised
from irgspp.core.relight.estimate import Estimate
from irgspp.core.relight.primary_hits import PrimaryHits
from irgspp.core.scene.camera import Camera

pytestmark = pytest.mark.usefixtures("engine")
CAMERA = Camera(61, 43, 60.0, 60.0, 30.5, 21.5, np.eye(4))


def plane(tilt: float = 0.0, covered=None) -> PrimaryHits:
    """A plane at distance 4, rotated about the vertical by `tilt`, in front of CAMERA."""
    ray = torch.from_numpy(CAMERA.rays()).view(-1, 3)
    index = torch.arange(len(ray)) if covered is None else torch.nonzero(covered.flatten())[:, 0]
    ray = ray[index]
    normal = torch.tensor([np.sin(tilt), 0.0, np.cos(tilt)]).float()
    depth = torch.tensor(-4.0) * normal[2] / (ray @ normal)
    n, point = len(index), depth[:, None] * ray
    view = -torch.nn.functional.normalize(ray, dim=1)
    materials = (torch.full((n, 3), 0.5), torch.full((n,), 0.6), torch.zeros(n), torch.ones(n))
    coverage = torch.zeros(43 * 61).index_fill(0, index, 1.0).view(43, 61)
    return PrimaryHits(CAMERA, index, ray, view, point, depth, normal.expand(n, 3).contiguous(), *materials, coverage, point)


def noise(surface: PrimaryHits, channels: int = 3) -> torch.Tensor:
    return 1 + 0.3 * torch.randn(len(surface.index), channels, generator=torch.Generator().manual_seed(0))


def estimate(diffuse: torch.Tensor, split: float | torch.Tensor = 0.0, specular: torch.Tensor | None = None, samples: int = 64) -> Estimate:
    """Diffuse light, or specular alone, whose halves of samples differ by `split`."""
    nothing = torch.zeros_like(diffuse)
    spread = nothing + split
    return Estimate(diffuse, nothing if specular is None else specular, spread, spread, samples)


@pytest.mark.parametrize("mode", ["paper", "demodulated", "off"])
def test_constant_light_stays_constant(mode):
    surface = plane(0.4, torch.rand(43, 61, generator=torch.Generator().manual_seed(1)) > 0.3)
    assert torch.allclose(denoised(estimate(surface.albedo * 2.0, 1.0), Guides(surface, 1.0), mode), torch.tensor(1.0), atol=1e-5)


@pytest.mark.parametrize("tilt", [0.0, 0.8])
def test_noise_goes_also_on_a_slope(tilt):
    surface = plane(tilt)
    out = Guides(surface, 1.0).filtered(noise(surface), IMAGE)
    assert out.std() < 0.1 and out.mean() == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("kept", [False, True])
def test_equals_the_definition(kept):
    """Compare with the weights of single pixels, written out."""
    surface = plane(0.5)
    tilted = torch.nn.functional.normalize(surface.normal + 0.1 * torch.rand(surface.normal.shape), dim=1)
    surface = dataclasses.replace(surface, normal=tilted, depth=surface.depth + 0.01 * torch.rand(len(surface.depth)))
    values, how = noise(surface, 5), Filter(1.5, 3, 0.05)
    out = Guides(surface, 2.0, kept).filtered(values, how)
    row, column = torch.meshgrid(torch.arange(43), torch.arange(61), indexing="ij")
    for y, x in ((20, 30), (0, 0), (42, 60), (7, 59)):
        at = y * 61 + x
        n, z, ray = surface.normal[at], surface.depth[at], surface.ray[at]
        slope = torch.stack([-z * (n[0] / 60) / (n @ ray), z * (n[1] / 60) / (n @ ray)])
        dx, dy = (column - x).flatten(), (row - y).flatten()
        weight = torch.exp(-(dx**2 + dy**2) / (2 * 1.5**2)) * ((dx.abs() <= 5) & (dy.abs() <= 5))
        weight = weight * (surface.normal @ n).clamp(0, 1) ** 8
        weight = weight * torch.exp(-(surface.depth - z).abs() / ((slope[0] * dx + slope[1] * dy).abs() + 0.05 * 2.0))
        assert torch.allclose(out[at], (weight[:, None] * values).sum(0) / weight.sum(), atol=1e-4)


def test_depth_and_normal_edges_stay_sharp():
    surface = plane()
    left = surface.index % 61 < 30
    values = torch.where(left[:, None], 1.0, 3.0).expand(-1, 3).contiguous()
    step = dataclasses.replace(surface, depth=torch.where(left, surface.depth, surface.depth + 1.0))
    assert torch.allclose(Guides(step, 1.0).filtered(values, IMAGE), values, atol=0.01)
    turned = torch.where(left[:, None], surface.normal, torch.tensor([0.6, 0.0, 0.8]))
    crease = dataclasses.replace(surface, normal=turned)
    assert torch.allclose(Guides(crease, 1.0).filtered(values, IMAGE), values, atol=0.01)
    assert (Guides(surface, 1.0).filtered(values, IMAGE) - values).abs().max() > 0.5  # without an edge it is blurred


def test_demodulated_keeps_texture():
    surface = plane()
    texture = torch.rand(len(surface.index), 3, generator=torch.Generator().manual_seed(2)) * 0.8 + 0.1
    surface = dataclasses.replace(surface, albedo=texture)
    assert torch.allclose(denoised(estimate(texture, 0.5), Guides(surface, 1.0), "demodulated"), texture, atol=1e-4)
    assert (denoised(estimate(texture), Guides(surface, 1.0), "paper") - texture).abs().mean() > 0.05


@pytest.mark.parametrize("lobe", ["diffuse", "specular"])
def test_noise_goes_as_far_as_the_halves_tell_of_it(lobe):
    surface = plane()
    true = torch.where(surface.index % 61 < 30, 0.2, 0.4)[:, None].expand(-1, 3)  # an edge of light that no guide shows
    random = torch.Generator().manual_seed(3)
    for sigma in (0.1, 0.01, 0.001, 0.0):
        halves = true + sigma * 2**0.5 * torch.randn(2, *true.shape, generator=random)
        seen, split = halves.mean(0), (halves[0] - halves[1]) / 2
        given = estimate(seen, split, samples=1024)
        if lobe == "specular":
            given = estimate(torch.zeros_like(seen), split, seen)
        error = (denoised(given, Guides(surface, 1.0)) - true).square().mean().sqrt()
        assert error <= 0.8 * sigma + 1e-4
    blurred = Guides(surface, 1.0).filtered(true.contiguous(), IMAGE)
    assert (blurred - true).square().mean().sqrt() > 0.015  # which the last ones are far below


def test_few_samples_that_agree_are_not_believed():
    surface = plane()
    lucky = torch.ones(len(surface.index), 3)
    lucky[20 * 61 + 30] = 1.5
    few, many = (denoised(estimate(lucky, samples=n), Guides(surface, 1.0))[20 * 61 + 30, 0] for n in (4, 4096))
    assert few < 1.1 and many > 1.45


def test_empty_image():
    surface = plane(covered=torch.zeros(43, 61))
    assert denoised(estimate(torch.zeros(0, 3)), Guides(surface, 1.0)).shape == (0, 3)


@pytest.mark.parametrize("kept", [False, True])
def test_corrected_equals_its_reference(kept):
    surface = plane(0.5, torch.rand(43, 61, generator=torch.Generator().manual_seed(4)) > 0.2)
    light, split, albedo = noise(surface), 0.3 * torch.randn(len(surface.index), 3), 0.2 + torch.rand(len(surface.index), 3)
    guides = Guides(surface, 1.0, kept)
    for chance in (0.0, 0.1):
        expected = corrected_reference(light, split, albedo, chance, guides, SPECULAR)
        assert torch.allclose(guides.corrected(light, split, albedo, chance, SPECULAR), expected, atol=1e-5)
    assert (expected - light).abs().max() > 0.1
