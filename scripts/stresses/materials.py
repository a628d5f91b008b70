# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials and views at the ends of their ranges: the BRDF, its sampling, its tables, and reflected light."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import torch
from irgspp.core.kernels.constants import PER_STRATUM
from irgspp.core.kernels.lobes import TracedDirections, lobe_rows, lobe_sums
from irgspp.core.shading.brdf import base_reflectance, bend_view_to_normal, ggx_alpha, specular_lobe
from irgspp.core.shading.environment_lookup import solid_angles, texel_directions
from irgspp.core.shading.light_distribution import LightDistribution
from irgspp.core.shading.rendering_equation import reflect_light
from irgspp.core.shading.sampling import Samples, draw
from irgspp.core.shading.specular_albedo import diffuse_fraction, specular_albedo
from irgspp.core.shading.split_sum import diffuse_light, shade, specular_light

from .case import Measured, group, relative

case = group("materials")
ROUGHNESS = (0.0, 1e-4, 0.05, 0.3, 1.0)
METALLIC = (0.0, 1.0)
ALBEDO = (0.0, 1.0)
COSINES = (-1.0, -0.3, -1e-6, 0.0, 1e-6, 1e-4, 1.5e-3, 0.1, 1.0)  # n.v, below 0 where normals face away; it is clamped at 0.001
COUNTS = (64, 128, 64)
Points = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


def points(cosines: tuple[float, ...] = COSINES, seed: int = 0) -> Points:
    """Return every combination of material and view, with random orientation.

    Args:
        cosines: values of n.v.
        seed: seed of the orientations.

    Returns:
        View and normal (P, 3), albedo (P, 3), roughness and metallic (P,).
    """
    rows = torch.tensor(list(itertools.product(ROUGHNESS, METALLIC, ALBEDO, cosines)), dtype=torch.float64)
    g = torch.Generator().manual_seed(seed)
    normal = torch.nn.functional.normalize(torch.randn(len(rows), 3, generator=g, dtype=torch.float64), dim=1)
    normal[:6] = torch.cat([torch.eye(3), -torch.eye(3)]).double()  # tangent frames have their special cases along the axes
    aside = torch.linalg.cross(normal, torch.randn(len(rows), 3, generator=g, dtype=torch.float64))
    aside = torch.nn.functional.normalize(aside, dim=1)
    n_v = rows[:, 3:]
    view = n_v * normal + (1 - n_v**2).sqrt() * aside
    parts = (view, normal, rows[:, 2:3].repeat(1, 3), rows[:, 0], rows[:, 1])
    return tuple(part.float() for part in parts)  # type: ignore[return-value]


def grazing_mirrors(values: Sequence[torch.Tensor]) -> torch.Tensor:
    """Return a mask (P,) of mirrors seen at grazing angles, where float32 has its limit.

    There direction and view almost cancel in the half vector, which is 2e-3 long and known to 1e-7, and the lobe is 2.5e-3 wide: a sample's
    weight is known to some per cent, the mean of many more precisely.
    """
    view, normal, _, roughness, _ = values
    return (roughness <= 0.05) & ((view * normal).sum(1) < 2e-3)


def some_light(height: int = 16) -> torch.Tensor:
    """Return a light map of bright and dark texels, (H, 2H, 3)."""
    return torch.rand(height, 2 * height, 3, generator=torch.Generator().manual_seed(2)) ** 4 * 10


def estimate(values: list[torch.Tensor], samples: Samples, incoming: torch.Tensor) -> torch.Tensor:
    """Return reflected light (P, 3).

    Args:
        values: `points`.
        samples: directions (P, N, 3) and densities (P, N).
        incoming: incident radiance (P, N, 3).
    """
    view, normal, albedo, roughness, metallic = values
    return sum(reflect_light(view, normal, albedo, roughness, metallic, samples, incoming))  # type: ignore[return-value]


def in_double(samples: Samples) -> Samples:
    """Return samples in float64 for the reference."""
    return Samples(samples.direction.double(), samples.density.double())


@case(
    "reflected light at all extremes",
    """Roughness 0 to 1, metallic and albedo 0 and 1, n.v from 1e-6, normals flipped and back-facing: reflected light is finite,
    not negative, and that of the float64 reference to 1e-4 of the light (1e-2 for mirrors at n.v < 0.002, float32's limit).""",
)
def reflection(measured: Measured) -> None:
    """Check reflected light."""
    values = list(points())
    light = LightDistribution(some_light())
    samples = draw(values[0], values[1], values[3], COUNTS, light, torch.Generator().manual_seed(3))
    incoming = torch.rand(*samples.direction.shape, generator=torch.Generator().manual_seed(4))
    fast = estimate(values, samples, incoming)
    slow = estimate([v.double() for v in values], in_double(samples), incoming.double())
    measured.note(f"{len(fast)} combinations")
    measured.finite("light", fast)
    measured.at_least("least", float(fast.min()), 0.0)
    error, hard = ((fast - slow).abs() / slow.abs().clamp_min(1.0)).amax(1), grazing_mirrors(values)
    measured.at_most("error", float(error[~hard].max()), 1e-4)
    measured.at_most("grazing mirrors", float(error[hard].max()), 1e-2)


@case(
    "gradients at all extremes",
    """The same points: gradients by albedo, roughness, metallic, normal, view and light are finite and those of float64 autograd to
    1e-3 (of mirrors at n.v < 0.002 to 0.1, float32's limit).""",
)
def gradients(measured: Measured) -> None:
    """Check the gradients of reflected light."""
    inputs = [*points(), *_incoming()]
    samples = draw(inputs[0], inputs[1], inputs[3], COUNTS, LightDistribution(some_light()), torch.Generator().manual_seed(3))
    weight = torch.rand(len(inputs[0]), 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    ours, theirs = (_leaves(inputs, dtype) for dtype in (torch.float32, torch.float64))
    (estimate(ours[:5], samples, ours[5]) * weight.float()).sum().backward()
    (estimate(theirs[:5], in_double(samples), theirs[5]) * weight).sum().backward()
    names, hard = ("view", "normal", "albedo", "roughness", "metallic", "light"), grazing_mirrors(inputs[:5])
    for name, mine, true in zip(names, ours, theirs, strict=True):
        measured.finite(f"gradient of {name}", [mine.grad, true.grad])
        assert mine.grad is not None and true.grad is not None
        measured.at_most(name, relative(mine.grad[~hard], true.grad[~hard]), 1e-3)
        measured.at_most("mirrors", relative(mine.grad[hard], true.grad[hard]), 0.1)


def _incoming() -> list[torch.Tensor]:
    """Return random incident light."""
    return [torch.rand(len(points()[0]), sum(COUNTS), 3, generator=torch.Generator().manual_seed(4))]


def _leaves(inputs: list[torch.Tensor], dtype: torch.dtype) -> list[torch.Tensor]:
    """Return inputs as leaves of a precision."""
    return [value.detach().to(dtype).clone().requires_grad_() for value in inputs]


@case(
    "gradients by finite differences",
    """Roughness, metallic, albedo: slopes of the float64 reference by finite differences agree with the float32 kernel's gradients to 1e-3
    (roughness above its floor of 0.05; below it the gradient is 0).""",
)
def finite_differences(measured: Measured) -> None:
    """Check gradients by finite differences."""
    values = list(points((1e-3, 0.1, 1.0)))
    samples = draw(values[0], values[1], values[3], COUNTS, LightDistribution(some_light()), torch.Generator().manual_seed(3))
    incoming = torch.rand(*samples.direction.shape, generator=torch.Generator().manual_seed(4))
    leaves = _leaves(values, torch.float32)
    estimate(leaves, samples, incoming).sum().backward()
    step, exact = 1e-6, [v.double() for v in values]
    for which, name in ((2, "albedo"), (3, "roughness"), (4, "metallic")):
        sides = []
        for sign in (1, -1):
            moved = [*exact]
            moved[which] = moved[which] + sign * step
            sides.append(estimate(moved, in_double(samples), incoming.double()).sum(1))
        slope, gradient = (sides[0] - sides[1]) / (2 * step), leaves[which].grad
        assert gradient is not None
        mine = gradient.sum(1) if gradient.ndim == 2 else gradient
        inside = (values[3] > 0.06) & (values[3] < 1)
        measured.at_most(name, relative(mine[inside], slope[inside]), 1e-3)
        if name == "roughness":
            measured.holds("no gradient below the floor", not mine[values[3] < 0.05].any())


@case(
    "energy under a white sky",
    """No material reflects more than it receives: diffuse and specular together are at most 1 under a white sky, for every view, by
    sampling (4096 samples; 1 % of noise) and by split-sum (0.1 %); a black metal seen frontally reflects nothing. The table's albedo
    of metal is that of the samples to 0.01 (0.05 where n.v lies in the table's first step of 1/63).""",
)
def energy(measured: Measured) -> None:
    """Check the conservation of energy."""
    view, normal, albedo, roughness, metallic = points(tuple(c for c in COSINES if c >= 0))
    white = torch.ones(16, 32, 3)
    many = (1024, 2048, 1024)
    samples = draw(view, normal, roughness, many, LightDistribution(white), torch.Generator().manual_seed(6))
    sent = estimate([view, normal, albedo, roughness, metallic], samples, torch.ones_like(samples.direction))
    measured.at_most("sampled", float(sent.max()), 1.01)
    split = shade(view, normal, albedo, roughness, metallic, diffuse_light(white), specular_light(white))
    measured.finite("split-sum", split)
    measured.at_most("split-sum", float(split.max()), 1.001)
    known = specular_albedo((bend_view_to_normal(view, normal) * normal).sum(1), roughness, base_reflectance(albedo, metallic[:, None]))
    apart, first = (known - sent).abs().amax(1), (view * normal).sum(1) < 1 / 63
    measured.at_most("table against samples, metal", float(apart[(metallic == 1) & ~first].max()), 0.01)
    measured.at_most("in its first step", float(apart[(metallic == 1) & first].max()), 0.05)
    black = (metallic == 1) & (albedo[:, 0] == 0) & ((view * normal).sum(1) > 0.99)
    measured.at_most("black metal seen frontally", float(sent[black].max()), 0.01)


@case(
    "tables of the specular albedo",
    """For roughness and n.v from 0 to 1 and beyond their ends: albedo and
    the fraction left to the diffuse lobe are between 0 and 1, gradients finite.""",
)
def tables(measured: Measured) -> None:
    """Check the tables of the specular albedo."""
    ends = torch.tensor([-1.0, 0.0, 1e-6, 1e-4, 1e-3, 0.05, 0.5, 1.0, 1.5])
    n_v, roughness = (v.flatten().requires_grad_() for v in torch.meshgrid(ends, ends, indexing="ij"))
    f0 = torch.linspace(0, 1, len(n_v))[:, None].repeat(1, 3).requires_grad_()
    seen, left = specular_albedo(n_v, roughness, f0), diffuse_fraction(n_v, roughness)
    (seen.sum() + left.sum()).backward()
    measured.finite("values and gradients", [seen, left, n_v.grad, roughness.grad, f0.grad])
    low, high = (float(getattr(torch.cat([seen.flatten(), left]).detach(), end)()) for end in ("min", "max"))
    measured.at_least("least", low, 0.0)
    measured.at_most("most", high, 1.0 + 1e-4)


@case(
    "directions drawn at all extremes",
    """Directions are unit to 1e-6, densities finite and positive, those of the float64 mixture in the same directions to 1e-3 (99.9 % of
    them; mirrors at n.v < 0.002 to 0.3); a sample's weight, f cos / density, is at most 10.""",
)
def directions(measured: Measured) -> None:
    """Check the sampled directions and their densities."""
    view, normal, _, roughness, _ = points()
    light = LightDistribution(some_light())
    samples = draw(view, normal, roughness, COUNTS, light, torch.Generator().manual_seed(7))
    measured.finite("directions and densities", [samples.direction, samples.density])
    measured.at_most("length off by", float((samples.direction.double().norm(dim=-1) - 1).abs().max()), 1e-6)
    measured.at_least("least density", float(samples.density.min()), 1e-9)
    exact = mixture_density(view, normal, roughness, samples.direction, light)
    error, hard = (samples.density - exact).abs() / exact, grazing_mirrors(points())
    measured.at_most("density's error", float(error[~hard].quantile(0.999)), 1e-3)
    measured.at_most("grazing mirrors", float(error[hard].quantile(0.999)), 0.3)
    bent, alpha = bend_view_to_normal(view, normal), ggx_alpha(roughness)
    n_l, value, _ = specular_lobe(bent, normal, alpha, samples.direction)
    carried = (value * n_l.clamp_min(0) / samples.density).max()
    measured.at_most("weight", float(carried), 10)


def mixture_density(
    view: torch.Tensor, normal: torch.Tensor, roughness: torch.Tensor, direction: torch.Tensor, light: LightDistribution
) -> torch.Tensor:
    """Return the density of the mixture of COUNTS, each part by its formula: cos / pi, G1 D / (4 n.v), the light's texel.

    Args:
        view: (P, 3) unit.
        normal: (P, 3) unit.
        roughness: (P,).
        direction: (P, N, 3) unit.
        light: distribution of the light.

    Returns:
        (P, N) float64.
    """
    n, d = normal.double()[:, None], direction.double()
    v = bend_view_to_normal(view.double(), normal.double())[:, None]
    a2 = ggx_alpha(roughness.double())[:, None] ** 2
    n_l, n_v = (n * d).sum(-1), (n * v).sum(-1)
    half = d + v
    length2 = (half * half).sum(-1).clamp_min(1e-14)
    n_h = (n_l + n_v) / length2.sqrt()
    aside = half - (n_l + n_v)[..., None] * n
    k = a2 + (aside * aside).sum(-1) / length2 * (1 - a2)
    lobe = a2 / (math.pi * k * k) * 0.5 / (n_v + (a2 + (1 - a2) * n_v * n_v).sqrt())
    lobe = torch.where(n_h > 0, lobe, 0.0)
    texel = light.density(direction).double()
    n_c, n_g, n_e = COUNTS
    return (n_c * n_l.clamp_min(0) / math.pi + n_g * lobe + n_e * texel) / sum(COUNTS)


@case(
    "the second stage's lobes",
    """Views of points against every texel of the light, with the same extremes: rows and sums are finite, not negative, those of the
    float64 lobe to 1e-3 of the largest, and the sums are the rows times the light to 1e-4.""",
)
def lobes(measured: Measured) -> None:
    """Check the lobes of the second stage."""
    view, normal, _, roughness, _ = points()
    place = torch.arange(len(view)).numpy()
    height = 8
    towards = texel_directions(height, 2 * height).reshape(-1, 3)
    angle = solid_angles(height, 2 * height)[:, None].repeat(1, 2 * height).flatten()
    seen = np.ones((len(view), len(towards)), np.float32)
    traced = TracedDirections(towards.T.contiguous().numpy(), angle.numpy(), seen, np.zeros((len(view), 3, len(towards)), np.float32))
    strata = np.repeat(towards.numpy()[:, :, None], PER_STRATUM, 2)  # a mean over them is the lobe in the direction
    alpha = ggx_alpha(roughness)
    f0_term, fresnel_term, *_ = lobe_rows(place, view.numpy(), normal.numpy(), alpha.numpy(), traced, strata, len(towards))
    bent = view.double() + (1e-3 - (view * normal).sum(1, keepdim=True).double()).clamp_min(0) * normal.double()
    directions = towards.double().expand(len(view), -1, 3)
    bent = torch.nn.functional.normalize(bent, dim=1)
    n_l, value, power = specular_lobe(bent, normal.double(), alpha.double(), directions)
    true = value * n_l.clamp_min(0) * angle
    rows = torch.from_numpy(np.stack([f0_term, fresnel_term]))
    exact = torch.stack([true * (1 - power), true * power])
    front = (view * normal).sum(1) > 1e-3  # at and behind the silhouette the kernel uses n.v = 0.001 with the unchanged view
    measured.finite("rows", rows)
    measured.at_least("least", float(rows.min()), 0.0)
    measured.at_most("error", float((rows - exact)[:, front].abs().max() / exact[:, front].max()), 1e-3)
    light = some_light(height).reshape(-1, 3)
    widths = np.unique(alpha.numpy())
    sums = np.stack(lobe_sums(place, view.numpy(), normal.numpy(), widths, traced, strata, light.numpy()))
    mine = sums[:, place, np.searchsorted(widths, alpha.numpy())]
    measured.at_most("sums against rows", relative(torch.from_numpy(mine), rows @ light), 1e-4)
