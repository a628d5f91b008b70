# SPDX-License-Identifier: GPL-3.0-or-later
"""Light maps of any brightness, contrast and size: distribution, lookup, prefiltering, and images under them."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import torch
from irgspp.core.kernels.cpu.directions import lightmap_place
from irgspp.core.relight.gaussian_query import GaussianQuery
from irgspp.core.relight.prepared_light import prepare_light
from irgspp.core.relight.relight_settings import RelightSettings
from irgspp.core.relight.relighter import Relighter
from irgspp.core.scene.dataset import Bound
from irgspp.core.scene.environment_files import DIM, repair_environment
from irgspp.core.scene.reconstruction import Reconstruction
from irgspp.core.shading.environment_lookup import direction_to_uv, lookup, solid_angles, texel_directions
from irgspp.core.shading.light_distribution import LightDistribution
from irgspp.core.shading.rendering_equation import reflect_light
from irgspp.core.shading.sampling import draw
from irgspp.core.shading.split_sum import LEVELS, diffuse_light, specular_light
from irgspp.core.stages.first.initialization import surfels

from .case import Measured, group, relative
from .light_maps import filtered, lattice, maps, quadrature
from .surfel_scenes import camera

case = group("lights")
SAMPLES = 4096


@case(
    "distributions of extreme maps",
    """One texel of 1e6 in black (in the middle, at the pole, on the seam), 1e-12, white, black, 2x1, 1x1 and 1x2 texels: the density
    integrates to 1 to 1e-6, is that of float64 to 1e-5, and 4096 samples fall into texels accordingly (to 0.002 of all).""",
)
def distributions(measured: Measured) -> None:
    """Check the distributions of extreme maps."""
    total, error, fraction = 0.0, 0.0, 0.0
    for name, light in maps().items():
        ours, exact = LightDistribution(light), LightDistribution(light.double())
        height, width = light.shape[:2]
        angle = solid_angles(height, width, torch.float64)[:, None].expand(height, width).reshape(-1)
        probability = ours.texels.double() * angle
        direction = ours.sample(lattice(SAMPLES).float())
        density = ours.density(direction)
        measured.finite(f"{name}: directions and densities", [direction, density])
        measured.holds(f"{name}: densities above 0", bool((ours.texels > 0).all()))
        total = max(total, abs(float(probability.sum()) - 1))
        error = max(error, float(((ours.texels - exact.texels).abs() / exact.texels).max()))
        u, v = direction_to_uv(direction.double())
        place = (v * height).long().clamp(0, height - 1) * width + (u * width).long().clamp(0, width - 1)
        fraction = max(fraction, float((torch.bincount(place, minlength=height * width) / SAMPLES - probability).abs().max()))
    measured.at_most("integral off by", total, 1e-6)
    measured.at_most("density's error", error, 1e-5)
    measured.at_most("samples' fraction off by", fraction, 2e-3)


@case(
    "a sample's own density",
    """Directions drawn by the kernel for 200 points under each of these maps carry the density that float64 gives to the very texel they
    were drawn from, but for 1 in 1000, which float32 rounds over a texel's edge; the weight of such a sample in an image is bounded
    by the mixture's other parts.""",
)
def own_density(measured: Measured) -> None:
    """Check the densities that samples carry."""
    g = torch.Generator().manual_seed(1)
    normal = torch.nn.functional.normalize(torch.randn(200, 3, generator=g), dim=1)
    roughness, astray = torch.rand(200, generator=g), 0.0
    for name, light in maps().items():
        ours, exact = LightDistribution(light), LightDistribution(light.double())
        samples = draw(normal, normal, roughness, (0, 0, 64), ours, torch.Generator().manual_seed(2))
        measured.finite(f"{name}: samples", [samples.direction, samples.density])
        true = exact.density(samples.direction.double())
        off = (samples.density - true).abs() > 1e-4 * true
        astray = max(astray, float(off.double().mean()))
    measured.at_most("fraction over an edge", astray, 1e-3)


@case(
    "prefiltering of extreme maps",
    """Diffuse and specular prefiltering of all these maps: finite, never negative, that of float64 by its definition to 1e-6 of the
    brightest texel, white stays white to 1e-6; gradients finite.""",
)
def filters(measured: Measured) -> None:
    """Check diffuse and specular prefiltering."""
    least, error = math.inf, 0.0
    for name, light in maps(8).items():
        leaf = light.clone().requires_grad_()
        diffuse, stack = diffuse_light(leaf), specular_light(leaf)
        (diffuse.sum() + stack.sum()).backward()
        measured.finite(f"{name}: maps and gradient", [diffuse, stack, leaf.grad])
        least = min(least, float(diffuse.min()), float(stack.min()))
        brightest = max(float(light.max()), 1e-30)
        for got, roughness in zip([diffuse, *stack[1:]], [None, *LEVELS[1:]], strict=True):
            error = max(error, float((got.double() - filtered(light, roughness)).abs().max()) / brightest)
    white = torch.ones(64, 128, 3)
    off = max(float((diffuse_light(white) - 1).abs().max()), float((specular_light(white) - 1).abs().max()))
    measured.at_least("least", least, 0.0)
    measured.at_most("error of the brightest", error, 1e-6)
    measured.at_most("white off by", off, 1e-6)


@case(
    "poles and seam",
    """Directions 1e-7 to 0.1 from either pole, at the poles, and to either side of the seam: a place in a map of 8192x4096 is that of
    float64 to 0.01 of a texel's height and to 0.01 of its width (where it has one: a pole has no azimuth), lookups agree, and gradients
    are finite.""",
)
def poles_and_seam(measured: Measured) -> None:
    """Check lookups at the poles and the seam."""
    height, width = 4096, 8192
    theta = torch.cat([torch.logspace(-7, -1, 61, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)])
    theta = torch.cat([theta, math.pi - theta])
    phi = torch.linspace(-3.1, 3.1, len(theta), dtype=torch.float64)
    near = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], 1)
    beside = math.pi - torch.logspace(-7, -1, 30, dtype=torch.float64)
    level = torch.full_like(beside, 1.1)
    seam = torch.stack([level.sin() * beside.cos(), level.sin() * beside.sin(), level.cos()], 1)
    direction = torch.cat([near, seam, seam * torch.tensor([1.0, -1.0, 1.0])]).float()
    x, y, z = direction.double().unbind(1)
    rho = torch.hypot(x, y)
    u, v = (place.double() for place in direction_to_uv(direction))
    exact = torch.atan2(rho, z) / math.pi
    rows = (v - exact).abs() * height
    columns = (u - (0.5 - torch.atan2(y, x) / (2 * math.pi))).abs() * width
    columns = torch.minimum(columns, width - columns)[rho > 1e-5]
    by_kernel = [abs(lightmap_place(*place)[1] - float(true)) for place, true in zip(direction.double().tolist(), exact, strict=True)]
    measured.at_most("rows off by", float(rows.max()), 0.01)
    measured.at_most("by the kernel", max(by_kernel) * height, 0.01)
    measured.at_most("columns off by", float(columns.max()), 0.01)
    smooth = (1 + texel_directions(64, 128)).contiguous()
    leaf, chart = direction.clone().requires_grad_(), smooth.clone().requires_grad_()
    seen = lookup(chart, leaf)
    seen.square().sum().backward()
    measured.at_most("lookup's error", float((seen - lookup(smooth.double(), direction.double())).abs().max()), 1e-4)
    measured.finite("gradients", [leaf.grad, chart.grad])
    distribution = LightDistribution(maps(64)["at the pole"])
    at_poles = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    measured.finite("density at the poles", distribution.density(at_poles))


@cache
def ball() -> Reconstruction:
    """Return a ball of 2000 surfels next to a small one, grey, half of it glossy metal."""
    z, angle = 1 - 2 * (np.arange(2000) + 0.5) / 2000, np.arange(2000) * 2.39996322972865
    normal = np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], -1)
    gaussians = surfels(normal, normal, np.full((2000, 3), 0.5), np.full(2000, math.sqrt(4 * math.pi / 2000)), 0.99)
    gaussians = gaussians.joined(surfels(1.3 + 0.3 * normal, normal, np.full((2000, 3), 0.5), np.full(2000, 0.03), 0.99))
    metal = gaussians.position[2] > 0
    gaussians.material[3] = torch.where(metal, -3.0, 0.0)
    gaussians.material[4] = torch.where(metal, 8.0, -8.0)
    return Reconstruction(gaussians, torch.full((16, 32, 3), 0.5), Bound((0.0, 0.0, 0.0), 2.2), np.eye(4))


@case(
    "images under extreme maps",
    """Two balls relit by each of these maps: finite, not negative, black under black, at most as bright as the brightest texel allows,
    1e-12 of the image under white where the light is 1e-12 (to 1e-3); under white no pixel reflects more than 1 (5 % of noise).""",
)
def images(measured: Measured) -> None:
    """Check relit images."""
    scene = ball()
    relighter = Relighter(scene, GaussianQuery(scene), RelightSettings(samples=32))
    surface = relighter.surface(camera(32, (3.0, 1.25, 2.0)))
    seen = {name: relighter.relit(surface, prepare_light(light.numpy())) for name, light in maps().items()}
    for name, image in seen.items():
        measured.finite(name, image)
        measured.holds(f"{name}: not negative", bool((image >= 0).all()))
        measured.holds(f"{name}: bounded", float(image[..., :3].max()) <= 1.5 * float(maps()[name].max()))
    measured.holds("black under black", not seen["black"][..., :3].any())
    measured.at_most("1e-12 against white", relative(seen["1e-12"][..., :3] * 1e12, seen["white"][..., :3]), 1e-3)
    measured.at_most("brightest under white", float((seen["white"][..., :3] / seen["white"][..., 3:].clamp_min(0.5)).max()), 1.05)


@case(
    "irradiance of a plane",
    """A white plane under one texel of 1e6, wherever it is, and under all other maps: 256 samples find the irradiance that float64
    quadrature finds to 3 % (the lamp is one in 2048 texels), in the mean over 16 planes.""",
)
def irradiance(measured: Measured) -> None:
    """Check the irradiance of planes."""
    g = torch.Generator().manual_seed(4)
    for name, light in maps().items():
        if name == "black" or min(light.shape[:2]) < 2:
            continue
        brightest = texel_directions(*light.shape[:2]).reshape(-1, 3)[light.sum(-1).argmax()]
        normal = torch.nn.functional.normalize(brightest + 0.7 * torch.randn(16, 3, generator=g), dim=1)
        samples = draw(normal, normal, torch.ones(16), (64, 64, 128), LightDistribution(light), g)
        incoming = lookup(light, samples.direction.reshape(-1, 3)).view(samples.direction.shape)
        white, black = torch.ones(16, 3), torch.zeros(16)
        diffuse, _ = reflect_light(normal, normal, white, torch.ones(16), black, samples, incoming, conserving=False)
        exact = quadrature(light, normal.double())
        measured.at_most(name, float((diffuse.double().mean(0) - exact.mean(0)).abs().max() / exact.mean(0).max()), 0.03)


@case(
    "files with impossible texels",
    "Maps with NaN, infinite or negative texels, and black ones, are repaired to finite values >= 0, black to grey, with remarks.",
)
def impossible(measured: Measured) -> None:
    """Check the repair of files."""
    image = np.full((4, 8, 3), 0.5, np.float32)
    image[0, 0], image[1, 1], image[2, 2] = np.nan, np.inf, -1.0
    light, remarks = repair_environment(image, "map")
    measured.holds("finite and >= 0", bool(np.isfinite(light).all() and (light >= 0).all()))
    measured.at_least("remarks", len(remarks), 3)
    dim, dim_remarks = repair_environment(np.zeros((4, 8, 3), np.float32), "map")
    measured.holds("black is reported and made dim", bool(dim_remarks) and float(dim.min()) == np.float32(DIM))


@case(
    "a map of 8192x4096",
    """With suns of 1e6 at the pole, on the seam and in the middle: density integrates to 1 to 1e-5, 90 % of 100,000 samples go to the
    suns, each with its texel's density in float64 (99.9 %), prepared and relit finite.""",
    quick=False,
)
def large_map(measured: Measured) -> None:
    """Check a large map."""
    light = torch.full((4096, 8192, 3), 1e-3)
    for row, column in ((0, 100), (2000, 0), (1500, 4000)):
        light[row, column] = 1e6 * float(solid_angles(4096, 8192, torch.float64)[2048] / solid_angles(4096, 8192, torch.float64)[row])
    ours = LightDistribution(light)
    angle = solid_angles(4096, 8192, torch.float64)
    measured.at_most("integral off by", abs(float((ours.texels.view(4096, -1).double().sum(1) * angle).sum()) - 1), 1e-5)
    g = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(1000, 3, generator=g), dim=1)
    samples = draw(normal, normal, torch.ones(1000), (0, 0, 100), ours, g)
    x, y, z = samples.direction.double().reshape(-1, 3).unbind(1)
    row = (torch.atan2(torch.hypot(x, y), z) / math.pi * 4096).long().clamp(0, 4095)
    column = ((0.5 - torch.atan2(y, x) / (2 * math.pi)) * 8192).long().clamp(0, 8191)
    true = ours.texels[row * 8192 + column]
    right = ((samples.density.flatten() - true).abs() <= 1e-3 * true).double().mean()
    measured.at_least("samples in the suns", float((samples.density > 1.0).double().mean()), 0.9)
    measured.at_least("with their texel's density", float(right), 0.999)
    looked_up = ours.density(samples.direction.reshape(-1, 3))
    measured.at_least("found again by lookup", float(((looked_up - true).abs() <= 1e-3 * true).double().mean()), 0.99)
    scene = ball()
    relighter = Relighter(scene, GaussianQuery(scene), RelightSettings(samples=32))
    measured.finite("image", relighter.relit(relighter.surface(camera(32)), prepare_light(light.numpy())))
