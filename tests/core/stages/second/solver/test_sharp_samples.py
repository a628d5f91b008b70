# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples at Gaussians show a pattern that is finer than the photographs' pixels; reflections stay those of the photographs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from irgspp.core.rendering.secondary_rays import SecondaryTracer
from irgspp.core.scene.dataset import Bound, View
from irgspp.core.scene.gaussians import METALLIC
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.scene.spherical_harmonics import SH_C0
from irgspp.core.stages.second.solver.sharp_samples import sh_image, sharp_samples

COUNT = 4000


@pytest.fixture(params=["red and blue", "light and dark"])
def patterned(splat_sphere, request):
    """A sphere of surfels of two colours at random, far smaller than a pixel; the colours (N, 3), and whether they are pigments."""
    sphere, pigment = splat_sphere(COUNT, opacity=0.99), request.param == "red and blue"
    first = torch.rand(COUNT, 1, generator=torch.Generator().manual_seed(0)) > 0.5
    pair = ((0.6, 0.2, 0.1), (0.1, 0.2, 0.6)) if pigment else ((0.6, 0.6, 0.6), (0.2, 0.2, 0.2))
    colour = torch.where(first, *(torch.tensor(values) for values in pair))
    sphere.sh[0] = (colour.T - 0.5) / SH_C0
    sphere.material = torch.logit(torch.tensor([0.5, 0.5, 0.5, 0.4, 0.01]))[:, None].repeat(1, COUNT)
    return Reconstruction(sphere, torch.full((8, 16, 3), 0.5), Bound((0, 0, 0), 1.0), np.eye(4), has_split_sum=True), colour, pigment


def sampled(scene, cameras, added=0.0, paint=None):
    """Sample images of the scene's own SH, brighter by `added` in encoded values."""
    views = [View("a", c, Path("a.png"), sh_image(scene, c, 2) + np.float32(added), None) for c in cameras]
    normal = scene.gaussians.position.T.numpy().copy()
    return sharp_samples(scene, normal, views, SecondaryTracer(scene), 0, 2, paint)


def gaussians_of(samples, scene):
    """Return the number of the Gaussian of each sample."""
    position = scene.gaussians.position.T
    return torch.cdist(samples.position, position).argmin(1)[samples.point]


def test_a_pattern_of_pigments_finer_than_pixels_is_seen(patterned, camera_ring):
    scene, colour, pigment = patterned
    cameras = camera_ring(12, 32)
    samples = sampled(scene, cameras)
    error = (samples.colour - colour[gaussians_of(samples, scene)]).abs()
    assert (error.max() < 0.01) if pigment else (error.median() > 0.1)  # a pixel mixes many surfels
    told = sampled(scene, cameras, paint=np.ones(COUNT))  # the mesh has no relief
    assert (told.colour - colour[gaussians_of(told, scene)]).abs().max() < 0.01
    brighter = sampled(scene, cameras, 0.1)
    assert (brighter.colour > samples.colour).float().mean() > 0.99  # what the SH do not explain stays


def test_metal_keeps_the_photographs_pixels(patterned, camera_ring):
    scene, colour, _ = patterned
    material = scene.gaussians.material.clone()
    material[METALLIC] = 20.0
    metal = sampled(replace(scene, gaussians=replace(scene.gaussians, material=material)), camera_ring(12, 32))
    assert (metal.colour - colour[gaussians_of(metal, scene)]).abs().amax(1).median() > 0.1


def test_sh_that_hold_all_radiance_are_the_colour(patterned, camera_ring):
    scene, colour, _ = patterned
    samples = sampled(replace(scene, has_split_sum=False), camera_ring(12, 32), 0.1)
    torch.testing.assert_close(samples.colour, colour[gaussians_of(samples, scene)], atol=1e-5, rtol=0)
