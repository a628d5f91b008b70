# SPDX-License-Identifier: GPL-3.0-or-later
"""Disks seen by the rasteriser and the ray tracer in float32 and by their twins in float64, and how far these are apart.

Both kernels take decisions: alpha below 1/255 is nothing, below 2 % of the light left a ray is done, the nearer disk comes first. Where
one hangs by a rounding error, float32 and float64 may rightly differ. Such rays are found by the reference alone: it is asked again with
NOISE in its inputs, a few units in float32's last place, and where its own answer moves by more than UNDECIDED, a share of what is
tolerated, the ray counts as undecided. Their share is said in the table and limited; on all others the kernels must compare with the reference.

What is perturbed: directions and logarithms; in images the place relative to the camera, along rays their direction. Differences of
places are exact in float32, so that nothing else has a rounding error that depends on where the scene lies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from irgspp.core.kernels.cpu.bvh import SurfelTree
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.kernels.reference.rasterize import rasterize_reference
from irgspp.core.kernels.reference.trace import trace_reference
from irgspp.core.kernels.trace import trace
from irgspp.core.scene.camera import Camera, look_at

from .case import Measured, relative

NOISE = 2.0**-21
UNDECIDED = 0.3  # of what is tolerated
TOLERANCE = 1e-4  # of a sum, relative where it is above 1
GRADIENT = 1e-3  # relative L2 of each parameter's gradient, or 10 times what NOISE does to the reference's
GEOMETRY = ("position", "quaternion", "log_scale", "opacity")

Surfels = dict[str, torch.Tensor]
Rays = tuple[torch.Tensor, torch.Tensor]
Evaluator = Callable[[Surfels], torch.Tensor]
Perturb = Callable[[Surfels, int], Surfels]


def cloud(count: int, seed: int = 0, size: float = 0.12) -> Surfels:
    """Disks of any orientation in a ball of about 1, of scale `size`, with opacity logits around 0."""
    g = torch.Generator().manual_seed(seed)
    random = lambda *shape: torch.randn(*shape, generator=g)  # noqa: E731
    geometry = (random(3, count) * 0.5, random(4, count), math.log(size) + 0.3 * random(2, count), 1.5 * random(count))
    rest = {"sh": 0.3 * random(16, 3, count), "extra": torch.rand(2, count, generator=g)}
    return dict(zip(GEOMETRY, geometry, strict=True)) | rest


def camera(size: int = 24, eye: tuple[float, float, float] = (3.0, 1.25, 2.0), target: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    """A small image; `eye` must be a number of float32, in which the kernels see it."""
    return Camera(size, size, 1.3 * size, 1.3 * size, size / 2, size / 2, look_at(eye, target))


def scattered(count: int, seed: int = 0, spread: float = 0.7) -> Rays:
    """Rays in all directions from places in and around the cloud."""
    g = torch.Generator().manual_seed(seed)
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    return spread * torch.randn(count, 3, generator=g), direction


@dataclass
class Evaluation:
    """What one of two viewers made of the surfels: rows of sums (P, C), and gradients by parameter."""

    rows: torch.Tensor
    gradients: dict[str, torch.Tensor | None]


def evaluated(evaluator: Evaluator, values: Surfels, weight: torch.Tensor | None, dtype: torch.dtype) -> Evaluation:
    """Sums of a evaluator, and gradients of their sum weighted by (P, C)."""
    leaves = {name: value.detach().to(dtype).clone().requires_grad_() for name, value in values.items()}
    rows = evaluator(leaves)
    if weight is not None and rows.requires_grad:
        (rows * weight.to(dtype)).sum().backward()
    return Evaluation(rows.detach(), {name: leaf.grad for name, leaf in leaves.items()})


def perturbed_values(values: Surfels, perturbed: Sequence[str], eye: np.ndarray | None, seed: int) -> Surfels:
    """The values in float64, those named with NOISE: of directions, logarithms, and distances from `eye` (3,)."""
    g = torch.Generator().manual_seed(seed)
    moved = {name: value.double() for name, value in values.items()}
    for name in perturbed:
        value = moved[name]
        size = value.nan_to_num(posinf=0.0, neginf=0.0).abs()
        if name == "position":
            size = (value - torch.as_tensor(eye)[:, None]).abs().amax(0, keepdim=True)
        elif name in ("log_scale", "opacity"):
            size = size + 1
        moved[name] = value + NOISE * size * torch.randn(value.shape, generator=g, dtype=torch.float64)
    return moved


@dataclass(frozen=True)
class Limits:
    """What a comparison allows: the share of undecided rays and the error of the others.

    perturbed: what noise is added to, `tries` times; None: all that the evaluator's rounding errors come from.
    """

    undecided: float = 0.1
    tolerance: float = TOLERANCE
    perturbed: Sequence[str] | None = None
    tries: int = 4


ALLOWED = Limits()


def compare(
    measured: Measured, what: str, pair: tuple[Evaluator, Evaluator], values: Surfels, reference: Surfels, perturb: Perturb, limits: Limits
) -> None:
    """Compare a kernel, which sees `values`, with its reference, which sees `reference`: sums over the rays that are decided, and gradients of
    their randomly weighted sum."""
    fast, slow = pair
    exact = evaluated(slow, reference, None, torch.float64).rows
    moved = torch.stack([evaluated(slow, perturb(reference, seed), None, torch.float64).rows for seed in range(limits.tries)])
    size = exact.abs().clamp_min(1)
    decided = ((moved - exact) / size).abs().amax((0, 2)) <= UNDECIDED * limits.tolerance
    weight = torch.randn(exact.shape, generator=torch.Generator().manual_seed(9), dtype=torch.float64)
    everything = evaluated(fast, values, weight, torch.float32)
    measured.finite(f"{what}: the reference's own sums", exact)
    measured.finite(f"{what}: sums", everything.rows)
    measured.finite(f"{what}: gradients", list(everything.gradients.values()))
    error = ((everything.rows.double() - exact) / size).abs().amax(1)
    measured.at_most(f"{what}: error", float(error[decided].max()) if decided.any() else 0.0, limits.tolerance)
    measured.at_most("undecided", 1 - float(decided.double().mean()), limits.undecided)
    _compare_gradients(measured, pair, values, reference, perturb, weight * decided[:, None])


def _compare_gradients(
    measured: Measured, pair: tuple[Evaluator, Evaluator], values: Surfels, reference: Surfels, perturb: Perturb, weight: torch.Tensor
) -> None:
    """The largest relative error of a gradient, against its limit."""
    ours, theirs = evaluated(pair[0], values, weight, torch.float32), evaluated(pair[1], reference, weight, torch.float64)
    moved = [evaluated(pair[1], perturb(reference, seed), weight, torch.float64) for seed in range(2)]
    worst, limit = 0.0, GRADIENT
    for name, true in theirs.gradients.items():
        mine = ours.gradients[name]
        if true is None or mine is None or not true.any():
            continue
        perturbed = [relative(other.gradients[name], true) for other in moved]  # type: ignore[arg-type]
        error, allowed = relative(mine, true), max(GRADIENT, 10 * max(perturbed))
        if error / allowed > worst / limit:
            worst, limit = error, allowed
    measured.at_most("gradient", worst, limit)


def compare_images(
    measured: Measured,
    what: str,
    values: Surfels,
    view: Camera,
    radius: float = 1.0,
    reference: Surfels | None = None,
    limits: Limits = ALLOWED,
) -> None:
    """The rasteriser against its reference."""
    perturbed = GEOMETRY if limits.perturbed is None else limits.perturbed

    def fast(v: Surfels) -> torch.Tensor:
        return rasterize(*v.values(), view, radius)[0].flatten(1).T

    def slow(v: Surfels) -> torch.Tensor:
        return rasterize_reference(*v.values(), view, radius).flatten(1).T

    def perturb(v: Surfels, seed: int) -> Surfels:
        return perturbed_values(v, perturbed, view.centre, seed)

    compare(measured, f"{what}, image", (fast, slow), values, values if reference is None else reference, perturb, limits)


def compare_rays(
    measured: Measured, what: str, values: Surfels, rays: Rays, reference: Surfels | None = None, limits: Limits = ALLOWED
) -> None:
    """The ray tracer against its reference."""
    both = {"origin": rays[0], "direction": rays[1]}
    perturbed = (*GEOMETRY[1:], "direction") if limits.perturbed is None else limits.perturbed

    def fast(v: Surfels) -> torch.Tensor:
        return trace(*v.values(), tree=SurfelTree.build(*(v[name] for name in GEOMETRY)))

    def slow(v: Surfels) -> torch.Tensor:
        return trace_reference(*v.values())

    def perturb(v: Surfels, seed: int) -> Surfels:
        return perturbed_values(v, perturbed, None, seed)

    compare(measured, f"{what}, rays", (fast, slow), values | both, (values if reference is None else reference) | both, perturb, limits)


def towards(eye: np.ndarray, points: torch.Tensor) -> Rays:
    """Rays from one place (3,) through points (R, 3)."""
    origin = torch.as_tensor(eye, dtype=torch.float32).expand(len(points), 3).contiguous()
    return origin, torch.nn.functional.normalize(points.float() - origin, dim=1)
