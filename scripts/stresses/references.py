# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of the float32 rasteriser and ray tracer with their float64 references.

Both kernels take decisions: alpha below 1/255 is ignored, a ray stops below 2 % of transmittance, the nearer surfel comes first. Where one
depends on a rounding error, float32 and float64 may rightly differ. Such rays are found by the reference alone: it is evaluated again with
NOISE in its inputs, a few units in float32's last place, and where its own answer changes by more than UNDECIDED, a fraction of the
tolerance, the ray counts as undecided. The fraction of undecided rays is reported and limited; on all others the kernels must agree with
the reference.

Perturbed values: directions and logarithms; in images the position relative to the camera, along rays their direction. Differences of
positions are exact in float32, so that no other rounding error depends on where the scene lies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from irgspp.core.kernels.cpu.bvh import SurfelTree
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.kernels.reference.rasterize import rasterize_reference
from irgspp.core.kernels.reference.trace import trace_reference
from irgspp.core.kernels.trace import trace
from irgspp.core.scene.camera import Camera

from .case import Measured, relative
from .surfel_scenes import GEOMETRY, Rays, Surfels

NOISE = 2.0**-21  # relative
UNDECIDED = 0.3  # fraction of the tolerance
TOLERANCE = 1e-4  # of a sum, relative where it is above 1
GRADIENT = 1e-3  # relative L2 of each parameter's gradient, or 10 times what NOISE does to the reference's

Evaluator = Callable[[Surfels], torch.Tensor]
Perturb = Callable[[Surfels, int], Surfels]


@dataclass
class Evaluation:
    """Result of one implementation.

    Attributes:
        rows: sums (P, C).
        gradients: gradients by parameter.
    """

    rows: torch.Tensor
    gradients: dict[str, torch.Tensor | None]


def evaluated(evaluator: Evaluator, values: Surfels, weight: torch.Tensor | None, dtype: torch.dtype) -> Evaluation:
    """Evaluate an implementation.

    Args:
        evaluator: rasteriser or ray tracer.
        values: surfels.
        weight: weights of the sums (P, C) for the gradients; None: no gradients.
        dtype: precision.
    """
    leaves = {name: value.detach().to(dtype).clone().requires_grad_() for name, value in values.items()}
    rows = evaluator(leaves)
    if weight is not None and rows.requires_grad:
        (rows * weight.to(dtype)).sum().backward()
    return Evaluation(rows.detach(), {name: leaf.grad for name, leaf in leaves.items()})


def perturbed_values(values: Surfels, perturbed: Sequence[str], eye: np.ndarray | None, seed: int) -> Surfels:
    """Return the values in float64 with NOISE added to some.

    Args:
        values: surfels.
        perturbed: names of the parameters.
        eye: point (3,) whose distance scales the noise of positions.
        seed: seed of the noise.
    """
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
    """Limits of a comparison.

    Attributes:
        undecided: largest fraction of undecided rays.
        tolerance: largest error of the other rays' sums.
        perturbed: parameters with noise; None: all that rounding errors come from.
        tries: number of perturbed evaluations.
    """

    undecided: float = 0.1
    tolerance: float = TOLERANCE
    perturbed: Sequence[str] | None = None
    tries: int = 4


ALLOWED = Limits()


def compare(
    measured: Measured, what: str, pair: tuple[Evaluator, Evaluator], values: Surfels, reference: Surfels, perturb: Perturb, limits: Limits
) -> None:
    """Compare a kernel with its reference: sums over the decided rays, and gradients of their randomly weighted sum.

    Args:
        measured: result of the case.
        what: name of the comparison.
        pair: kernel and reference.
        values: surfels that the kernel gets.
        reference: surfels that the reference gets.
        perturb: adds noise to surfels by a seed.
        limits: what the comparison allows.
    """
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
    """Compare the gradients, and check the largest relative error against its limit."""
    ours, theirs = evaluated(pair[0], values, weight, torch.float32), evaluated(pair[1], reference, weight, torch.float64)
    moved = [evaluated(pair[1], perturb(reference, seed), weight, torch.float64) for seed in range(2)]
    worst, limit = 0.0, GRADIENT
    for name, true in theirs.gradients.items():
        mine = ours.gradients[name]
        if true is None or mine is None or not true.any():
            continue
        noise = [relative(other.gradients[name], true) for other in moved]  # type: ignore[arg-type]
        error, allowed = relative(mine, true), max(GRADIENT, 10 * max(noise))
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
    """Compare the rasteriser with its reference.

    Args:
        measured: result of the case.
        what: name of the comparison.
        values: surfels.
        view: camera.
        radius: radius of the scene, which scales the near plane.
        reference: surfels that the reference gets; None: the same.
        limits: what the comparison allows.
    """
    perturbed = GEOMETRY if limits.perturbed is None else limits.perturbed

    def fast(v: Surfels) -> torch.Tensor:
        """Rasterise, (P, C)."""
        return rasterize(*v.values(), view, radius)[0].flatten(1).T

    def slow(v: Surfels) -> torch.Tensor:
        """Rasterise by the reference, (P, C)."""
        return rasterize_reference(*v.values(), view, radius).flatten(1).T

    def perturb(v: Surfels, seed: int) -> Surfels:
        """Add noise to surfels."""
        return perturbed_values(v, perturbed, view.centre, seed)

    compare(measured, f"{what}, image", (fast, slow), values, values if reference is None else reference, perturb, limits)


def compare_rays(
    measured: Measured, what: str, values: Surfels, rays: Rays, reference: Surfels | None = None, limits: Limits = ALLOWED
) -> None:
    """Compare the ray tracer with its reference.

    Args:
        measured: result of the case.
        what: name of the comparison.
        values: surfels.
        rays: origins and directions (R, 3).
        reference: surfels that the reference gets; None: the same.
        limits: what the comparison allows.
    """
    both = {"origin": rays[0], "direction": rays[1]}
    perturbed = (*GEOMETRY[1:], "direction") if limits.perturbed is None else limits.perturbed

    def fast(v: Surfels) -> torch.Tensor:
        """Trace, (R, C)."""
        return trace(*v.values(), tree=SurfelTree.build(*(v[name] for name in GEOMETRY)))

    def slow(v: Surfels) -> torch.Tensor:
        """Trace by the reference, (R, C)."""
        return trace_reference(*v.values())

    def perturb(v: Surfels, seed: int) -> Surfels:
        """Add noise to surfels and rays."""
        return perturbed_values(v, perturbed, None, seed)

    compare(measured, f"{what}, rays", (fast, slow), values | both, (values if reference is None else reference) | both, perturb, limits)
