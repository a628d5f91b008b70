# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracing of radiance transfer: the hemispheres of surface points, and again where texels of the light are split."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch

from ....kernels.lobes import TracedDirections
from ....machine.backend import by_warp
from ....rendering.secondary_rays import SecondaryTracer
from .light_texels import LightTexels
from .multi_view_samples import MultiViewSamples
from .radiance_transfer import RadianceTransfer, cosine_weighted

SPLIT_TEXELS = 24  # texels that are split at a time; a multiple of 8, as the kernels need
RAY_BATCH = 1 << 18  # traced at a time, unless memory is short


@contextmanager
def rays_at_a_time(count: int) -> Iterator[None]:
    """Trace about `count` rays at a time within the block: fewer need less memory and more time; the result is the same."""
    global RAY_BATCH
    before, RAY_BATCH = RAY_BATCH, count
    try:
        yield
    finally:
        RAY_BATCH = before


def trace_radiance_transfer(
    position: torch.Tensor,
    normal: torch.Tensor,
    tracer: SecondaryTracer,
    texels: LightTexels,
    *,
    side: int = 1,
    seed: int,
    indirect: bool,
    on_step: Callable[[int], object] = lambda done: None,
    rotations: torch.Tensor | None = None,
) -> RadianceTransfer:
    """Trace the hemispheres of P points.

    Args:
        position: (P, 3) world.
        normal: (P, 3) unit.
        tracer: tracer of the Gaussians.
        texels: texels of the light.
        side: rays through each texel along a side.
        seed: seed of the random ray directions.
        indirect: trace the light that the object reflects onto itself, too; it casts shadows in any case.
        on_step: called with the number of points done; may raise.
        rotations: (V, 3, 3) from the world to the frame of the light of each view; None where the light stands still.
    """
    traced = _traced(position, normal, texels.directions(side, seed), tracer, indirect, on_step)
    return _transfer(normal, texels, traced, indirect, rotations)


def split_brightest(
    transfer: RadianceTransfer, light: torch.Tensor, samples: MultiViewSamples, tracer: SecondaryTracer, seed: int, rows: int
) -> tuple[RadianceTransfer, np.ndarray]:
    """Split the texels whose light is spread over too large an area, as that of a lamp, and trace the rays through the new ones.

    Args:
        transfer: radiance transfer to P points, of a light that stands still.
        light: (T, 3) linear radiance.
        samples: multi-view samples of the P points.
        tracer: tracer of the Gaussians.
        seed: seed of the random ray directions.
        rows: rows of a map whose texels are as small as parts may be.

    Returns:
        The transfer from T' texels, and the old texel (T',) in which each lies; the same where texels are small enough.
    """
    chosen = transfer.texels.brightest(light, rows, SPLIT_TEXELS)
    if not chosen.any():
        return transfer, np.arange(transfer.texels.count)
    texels, new, old = transfer.texels.split(chosen)
    before = TracedDirections(*map(torch.as_tensor, transfer.traced))
    subdivisions = before.direction.shape[-1] // transfer.texels.count
    directions = new.directions(math.isqrt(subdivisions), seed)
    of_new = _traced(samples.position, samples.normal, directions, tracer, transfer.has_indirect, lambda done: None)
    kept = torch.from_numpy(np.flatnonzero(~chosen)).to(samples.normal.device)
    joined = []
    for whole, part in zip(before, of_new, strict=True):
        unsplit = whole.unflatten(-1, (subdivisions, -1)).index_select(-1, kept)
        joined.append(torch.cat([unsplit, part.unflatten(-1, (subdivisions, -1))], -1).flatten(-2))
    return _transfer(samples.normal, texels, TracedDirections(*joined), transfer.has_indirect, None), old


def _traced(
    position: torch.Tensor,
    normal: torch.Tensor,
    directions: tuple[np.ndarray, np.ndarray],
    tracer: SecondaryTracer,
    indirect: bool,
    on_step: Callable[[int], object],
) -> TracedDirections:
    """Return the attribute `traced` of a transfer as tensors; `directions` are those of `LightTexels.directions`."""
    direction, solid_angle = (torch.from_numpy(a).to(position.device) for a in directions)
    cosine = (normal @ direction).clamp_min(0)
    visibility, radiance = _trace_directions(tracer.above(position, normal), direction, cosine > 0, tracer, on_step)
    return TracedDirections(direction, solid_angle, visibility, radiance if indirect else torch.zeros_like(radiance))


def _transfer(
    normal: torch.Tensor, texels: LightTexels, traced: TracedDirections, indirect: bool, rotations: torch.Tensor | None
) -> RadianceTransfer:
    """Return the transfer whose rays were traced."""
    irradiance, indirect_irradiance = cosine_weighted(normal, traced, texels.count)
    arrays = traced if by_warp(normal) else TracedDirections(*(tensor.numpy() for tensor in traced))
    return RadianceTransfer(texels, arrays, irradiance, indirect_irradiance, indirect, rotations)


def _trace_directions(
    origin: torch.Tensor, direction: torch.Tensor, selected: torch.Tensor, tracer: SecondaryTracer, on_step: Callable[[int], object]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Trace rays from origins (P, 3) in `selected` (P, D) directions (3, D): transmittance (P, D), radiance (P, 3, D); else 0."""
    points, count = selected.shape
    visible, incoming = origin.new_zeros(points, count), origin.new_zeros(points, 3, count)
    toward, batch = direction.T.contiguous(), max(1, 2 * RAY_BATCH // count)
    for begin in range(0, points, batch):
        p, d = torch.nonzero(selected[begin : begin + batch], as_tuple=True)
        free, radiance = tracer.look(origin[begin + p], toward[d])
        visible[begin + p, d] = free
        incoming[begin + p, :, d] = radiance
        on_step(min(begin + batch, points))
    return visible, incoming
