# SPDX-License-Identifier: GPL-3.0-or-later
"""Precomputed radiance transfer (Sloan et al. 2002) to surface points: traced once, as geometry is frozen.

With it the image is linear in the light and free of Monte Carlo noise, so that light, albedo and gloss can be separated.

A light that turns relative to the object, as on a turntable, has other texels in a traced direction in every view. The lobes of a view are
therefore computed in the frame of its light, for the directions of the texels; visibility and indirect light of such a direction are those
of the nearest traced one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch

from ...kernels.lobes import lobe_rows, lobe_sums
from ...machine.backend import by_warp
from ...rendering.secondary_rays import SecondaryTracer
from ...shading.brdf import ggx_alpha
from ...shading.environment_lookup import from_light_frame, solid_angles, to_light_frame
from .multi_view_samples import MultiViewSamples

RAYS = 1 << 18  # traced at a time, unless memory is short


@contextmanager
def rays_at_a_time(count: int) -> Iterator[None]:
    """Trace about `count` rays at a time within the block: fewer need less memory and more time; the result is the same."""
    global RAYS
    before, RAYS = RAYS, count
    try:
        yield
    finally:
        RAYS = before


def subdivided_directions(height: int, side: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw one direction in each of side x side strata of every texel of a lat-long map.

    Args:
        height: rows of the map, which has 2 height columns.
        side: strata along a side of a texel.
        seed: of the positions within the strata.

    Returns:
        Unit directions (3, D) and solid angles (D,) in steradians, float32, D = side^2 x 2 height^2; texels run fastest.
    """
    random, width = np.random.default_rng(seed), 2 * height
    edges = np.cos(np.arange(height + 1) * (math.pi / height))[:, None]
    parts = []
    for i in range(side):
        for j in range(side):
            down, across = (i + random.random((height, width))) / side, (j + random.random((height, width))) / side
            z = edges[:-1] + (edges[1:] - edges[:-1]) * down
            phi = math.pi - (np.arange(width) + across) * (2 * math.pi / width)
            r = np.sqrt(1 - z * z)
            parts.append(np.stack([r * np.cos(phi), r * np.sin(phi), z]).reshape(3, -1))
    angle = np.repeat(solid_angles(height, width, torch.float64).numpy() / side**2, width)
    return np.concatenate(parts, 1).astype(np.float32), np.tile(angle, side**2).astype(np.float32)


@dataclass(frozen=True, eq=False)
class RadianceTransfer:
    """Radiance transfer from T texels of a light map, and from the object itself, to P points.

    Attributes:
        height: rows of the light map; T = 2 height^2.
        fixed: directions (3, D), solid angles (D,), visibility (P, D) and indirect radiance (P, 3, D), float32, as `core/kernels/lobes.py`
            takes them: numpy arrays on the CPU, tensors on a GPU.
        irradiance: (P, T) irradiance / pi per unit radiance of a texel.
        indirect: (P, 3) irradiance / pi of the light that the object reflects onto itself.
        bounces: False where that light was left out.
        rotations: (V, 3, 3) from the world to the frame of the light of each view; None where the light stands still.
    """

    height: int
    fixed: tuple[Any, ...]
    irradiance: torch.Tensor
    indirect: torch.Tensor
    bounces: bool
    rotations: torch.Tensor | None = None

    @cached_property
    def nearest(self) -> torch.Tensor:
        """(V, D) number of the traced direction nearest to each direction of the texels of a view's light."""
        assert self.rotations is not None
        direction = torch.as_tensor(self.fixed[0]).T
        return torch.stack([(from_light_frame(direction, rotation) @ direction.T).argmax(1) for rotation in self.rotations])

    def arrays(self, *tensors: torch.Tensor) -> tuple[Any, ...]:
        """Convert tensors (...,) to the type of `fixed`: numpy arrays that share memory, or the tensors themselves."""
        return tensors if isinstance(self.fixed[0], torch.Tensor) else tuple(t.numpy() for t in tensors)

    def rows(self, samples: MultiViewSamples, roughness: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Compute the specular lobe of each sample as weights of the texels, see `lobe_rows`.

        Args:
            samples: K samples of the P points.
            roughness: (P,) of the points.

        Returns:
            The part that F0 scales and the part that Fresnel adds, (K, T) each, and both parts of the indirect light, (K, 3) each.
        """
        texels = 2 * self.height**2
        if self.rotations is None:
            point, view, normal, alpha = self.arrays(samples.point, samples.view, samples.normal, ggx_alpha(roughness))
            return tuple(map(torch.as_tensor, lobe_rows(point, view, normal, alpha, self.fixed, texels)))
        out = [samples.colour.new_empty(len(samples.point), size) for size in (texels, texels, 3, 3)]
        for one in self._views(samples):
            point, view, normal, alpha = self.arrays(one.own, one.view, one.normal, ggx_alpha(roughness[one.point]))
            for values, part in zip(out, lobe_rows(point, view, normal, alpha, one.fixed, texels), strict=True):
                values[one.sample] = torch.as_tensor(part)
        return tuple(out)

    def sums(self, samples: MultiViewSamples, roughness: torch.Tensor, light: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Integrate the specular lobe of each sample for several roughness values, see `lobe_sums`.

        Args:
            samples: K samples of the P points.
            roughness: (J,) values, the same for all points.
            light: (T, 3) linear radiance.

        Returns:
            The part that F0 scales and the part that Fresnel adds, (K, J, 3) each, with indirect light.
        """
        if self.rotations is None:
            point, view, normal, alphas, radiance = self.arrays(samples.point, samples.view, samples.normal, ggx_alpha(roughness), light)
            scaled, added = lobe_sums(point, view, normal, alphas, self.fixed, radiance)
            return torch.as_tensor(scaled), torch.as_tensor(added)
        out = samples.colour.new_empty(2, len(samples.point), len(roughness), 3)
        for one in self._views(samples):
            point, view, normal, alphas, radiance = self.arrays(one.own, one.view, one.normal, ggx_alpha(roughness), light)
            for values, part in zip(out, lobe_sums(point, view, normal, alphas, one.fixed, radiance), strict=True):
                values[one.sample] = torch.as_tensor(part)
        return out[0], out[1]

    def diffuse_rows(self, samples: MultiViewSamples) -> DiffuseRows:
        """Return the irradiance / pi of the samples as weights of the texels: one row per point, or per sample where the light turns."""
        if self.rotations is None:
            return DiffuseRows(self.irradiance, self.indirect, samples.point)
        rows = samples.colour.new_empty(len(samples.point), 2 * self.height**2)
        indirect = samples.colour.new_empty(len(samples.point), 3)
        direction, angle = (torch.as_tensor(array) for array in self.fixed[:2])
        for one in self._views(samples):
            visible, incoming = (torch.as_tensor(array) for array in one.fixed[2:])
            rows[one.sample], indirect[one.sample] = _cosine_weighted(one.normal, direction, angle, visible, incoming, rows.shape[1])
        return DiffuseRows(rows, indirect, torch.arange(len(rows), device=rows.device))

    def _views(self, samples: MultiViewSamples) -> Iterator[_LitView]:
        """Yield the samples of one view after another, in the frame of its light."""
        assert self.rotations is not None and samples.image is not None
        direction, angle, visible, incoming = self.fixed
        for number, rotation in enumerate(self.rotations):
            sample = torch.nonzero(samples.image == number)[:, 0]
            if not len(sample):
                continue
            point = samples.point[sample]
            view, normal = (to_light_frame(vector, rotation).contiguous() for vector in (samples.view[sample], samples.normal[point]))
            rows, columns = self.arrays(point, self.nearest[number])
            fixed = (direction, angle, visible[rows][:, columns], incoming[rows][:, :, columns])
            own = torch.arange(len(sample), device=sample.device)
            yield _LitView(sample, point, own, view, normal, (*fixed[:2], *(_contiguous(array) for array in fixed[2:])))


@dataclass(frozen=True, eq=False)
class DiffuseRows:
    """Irradiance of K samples, linear in the light.

    Attributes:
        rows: (Q, T) irradiance / pi per unit radiance of a texel; Q points, or K samples where the light turns.
        indirect: (Q, 3) irradiance / pi of the light that the object reflects onto itself.
        row: (K,) row of each sample.
    """

    rows: torch.Tensor
    indirect: torch.Tensor
    row: torch.Tensor

    def irradiance(self, light: torch.Tensor) -> torch.Tensor:
        """Return the irradiance / pi (K, 3) of the samples under a light (T, 3)."""
        return (self.rows @ light + self.indirect)[self.row]


@dataclass(frozen=True, eq=False)
class _LitView:
    """Samples of one view, in the frame of its light.

    Attributes:
        sample: (M,) number of each sample.
        point: (M,) its point.
        own: (M,) 0..M-1, its row in `fixed`.
        view: (M, 3) unit, towards the camera.
        normal: (M, 3) unit.
        fixed: as that of `RadianceTransfer`, with M rows.
    """

    sample: torch.Tensor
    point: torch.Tensor
    own: torch.Tensor
    view: torch.Tensor
    normal: torch.Tensor
    fixed: tuple[Any, ...]


def _contiguous(array: Any) -> Any:
    """Return an array or tensor laid out in rows."""
    return array.contiguous() if isinstance(array, torch.Tensor) else np.ascontiguousarray(array)


def _cosine_weighted(
    normal: torch.Tensor, direction: torch.Tensor, angle: torch.Tensor, visible: torch.Tensor, incoming: torch.Tensor, texels: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the irradiance / pi of P normals (P, 3) per unit radiance of each texel, (P, T), and that of the indirect light, (P, 3)."""
    weight = (normal @ direction).clamp_min(0) * angle / math.pi
    return (weight * visible).view(len(normal), -1, texels).sum(1), torch.einsum("pd,pcd->pc", weight, incoming)


def trace_radiance_transfer(
    position: torch.Tensor,
    normal: torch.Tensor,
    tracer: SecondaryTracer,
    height: int,
    side: int,
    seed: int,
    indirect: bool,
    step: Callable[[int], object] = lambda done: None,
    rotations: torch.Tensor | None = None,
) -> RadianceTransfer:
    """Trace the hemispheres of P points.

    Args:
        position: (P, 3) world.
        normal: (P, 3) unit.
        tracer: of the Gaussians.
        height: rows of the light map.
        side: rays through each texel along a side.
        seed: of the ray directions.
        indirect: with the light that the object reflects onto itself; it casts shadows in any case.
        step: called with the number of points done; may raise.
        rotations: (V, 3, 3) from the world to the frame of the light of each view; None where the light stands still.
    """
    direction, angle = (torch.from_numpy(a).to(position.device) for a in subdivided_directions(height, side, seed))
    cosine = (normal @ direction).clamp_min(0)
    visible, incoming = _trace_directions(tracer.above(position, normal), direction, cosine > 0, tracer, step)
    if not indirect:
        incoming.zero_()
    rows, own = _cosine_weighted(normal, direction, angle, visible, incoming, 2 * height * height)
    fixed = (direction, angle, visible, incoming)
    return RadianceTransfer(height, fixed if by_warp(position) else tuple(t.numpy() for t in fixed), rows, own, indirect, rotations)


def _trace_directions(
    origin: torch.Tensor, direction: torch.Tensor, selected: torch.Tensor, tracer: SecondaryTracer, step: Callable[[int], object]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Trace rays from origins (P, 3) in `selected` (P, D) directions (3, D): transmittance (P, D), radiance (P, 3, D); else 0."""
    points, count = selected.shape
    visible, incoming = origin.new_zeros(points, count), origin.new_zeros(points, 3, count)
    toward, batch = direction.T.contiguous(), max(1, 2 * RAYS // count)
    for begin in range(0, points, batch):
        p, d = torch.nonzero(selected[begin : begin + batch], as_tuple=True)
        free, radiance = tracer.look(origin[begin + p], toward[d])
        visible[begin + p, d] = free
        incoming[begin + p, :, d] = radiance
        step(min(begin + batch, points))
    return visible, incoming
