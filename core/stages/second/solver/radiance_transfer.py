# SPDX-License-Identifier: GPL-3.0-or-later
"""Precomputed radiance transfer (Sloan et al. 2002) to surface points: traced once, as geometry is frozen.

With it the image is linear in the light and free of Monte Carlo noise, so that light, albedo and gloss can be separated.

A light that turns relative to the object, as on a turntable, has other texels in a traced direction in every view. The lobes of a view are
therefore computed in the frame of its light, for the directions of the texels; visibility and indirect light of such a direction are those
of the nearest traced one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch

from ....kernels.lobes import TracedDirections, lobe_rows, lobe_sums
from ....shading.brdf import ggx_alpha
from ....shading.environment_lookup import from_light_frame, to_light_frame
from .light_texels import LightTexels
from .multi_view_samples import MultiViewSamples


@dataclass(frozen=True, eq=False)
class RadianceTransfer:
    """Radiance transfer from T texels of a light map, and from the object itself, to P points.

    Attributes:
        texels: texels of the light.
        traced: transport from D traced directions: numpy arrays on the CPU, tensors on a GPU.
        irradiance: (P, T) irradiance / pi per unit radiance of a texel.
        indirect: (P, 3) irradiance / pi of the light that the object reflects onto itself.
        has_indirect: False where that light was left out.
        rotations: (V, 3, 3) from the world to the frame of the light of each view; None where the light stands still.
    """

    texels: LightTexels
    traced: TracedDirections
    irradiance: torch.Tensor
    indirect: torch.Tensor
    has_indirect: bool
    rotations: torch.Tensor | None = None

    @cached_property
    def strata(self) -> Any:
        """(D, 3, PER_STRATUM) directions in the stratum of each traced one, as an array like those of `traced`."""
        subdivisions = self.traced.direction.shape[1] // self.texels.count
        directions = torch.from_numpy(self.texels.strata(math.isqrt(subdivisions))).to(self.irradiance.device)
        return self.arrays(directions)[0]

    @cached_property
    def nearest(self) -> torch.Tensor:
        """(V, D) number of the traced direction nearest to each direction of the texels of a view's light."""
        assert self.rotations is not None
        direction = torch.as_tensor(self.traced.direction).T
        return torch.stack([(from_light_frame(direction, rotation) @ direction.T).argmax(1) for rotation in self.rotations])

    def arrays(self, *tensors: torch.Tensor) -> tuple[Any, ...]:
        """Convert tensors (...,) to the type of `traced`: numpy arrays that share memory, or the tensors themselves."""
        return tensors if isinstance(self.traced.direction, torch.Tensor) else tuple(t.numpy() for t in tensors)

    def subset(self, kept: torch.Tensor) -> RadianceTransfer:
        """Return the transfer to the points `kept` (P,) bool."""
        (rows,) = self.arrays(kept)
        visibility, indirect_radiance = self.traced.visibility[rows], self.traced.indirect_radiance[rows]
        traced = self.traced._replace(visibility=visibility, indirect_radiance=indirect_radiance)
        return replace(self, traced=traced, irradiance=self.irradiance[kept], indirect=self.indirect[kept])

    def rows(self, samples: MultiViewSamples, roughness: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Compute the specular lobe of each sample as weights of the texels, see `lobe_rows`.

        Args:
            samples: K samples of the P points.
            roughness: (P,) of the points.

        Returns:
            The lobe is F0 S + S': S and S' as rows of the light, (K, T) each, and S and S' of the indirect light, (K, 3) each.
        """
        texels = self.texels.count
        if self.rotations is None:
            point, view, normal, alpha = self.arrays(samples.point, samples.view, samples.normal, ggx_alpha(roughness))
            return tuple(map(torch.as_tensor, lobe_rows(point, view, normal, alpha, self.traced, self.strata, texels)))
        out = [samples.colour.new_empty(len(samples.point), size) for size in (texels, texels, 3, 3)]
        for one in self._views(samples):
            point, view, normal, alpha = self.arrays(one.row, one.view, one.normal, ggx_alpha(roughness[one.point]))
            for values, part in zip(out, lobe_rows(point, view, normal, alpha, one.traced, self.strata, texels), strict=True):
                values[one.sample] = torch.as_tensor(part)
        return tuple(out)

    def sums(self, samples: MultiViewSamples, roughness: torch.Tensor, light: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Integrate the specular lobe of each sample for several roughness values, see `lobe_sums`.

        Args:
            samples: K samples of the P points.
            roughness: (J,) values, the same for all points.
            light: (T, 3) linear radiance.

        Returns:
            The lobe is F0 S + S': S and S', (K, J, 3) each, with indirect light.
        """
        if self.rotations is None:
            point, view, normal, alphas, radiance = self.arrays(samples.point, samples.view, samples.normal, ggx_alpha(roughness), light)
            f0_term, fresnel_term = lobe_sums(point, view, normal, alphas, self.traced, self.strata, radiance)
            return torch.as_tensor(f0_term), torch.as_tensor(fresnel_term)
        out = samples.colour.new_empty(2, len(samples.point), len(roughness), 3)
        for one in self._views(samples):
            point, view, normal, alphas, radiance = self.arrays(one.row, one.view, one.normal, ggx_alpha(roughness), light)
            for values, part in zip(out, lobe_sums(point, view, normal, alphas, one.traced, self.strata, radiance), strict=True):
                values[one.sample] = torch.as_tensor(part)
        return out[0], out[1]

    def diffuse_rows(self, samples: MultiViewSamples) -> DiffuseRows:
        """Return the irradiance / pi of the samples as weights of the texels: one row per point, or per sample where the light turns."""
        if self.rotations is None:
            return DiffuseRows(self.irradiance, self.indirect, samples.point)
        rows = samples.colour.new_empty(len(samples.point), self.texels.count)
        indirect = samples.colour.new_empty(len(samples.point), 3)
        for one in self._views(samples):
            traced = TracedDirections(*map(torch.as_tensor, one.traced))
            rows[one.sample], indirect[one.sample] = cosine_weighted(one.normal, traced, rows.shape[1])
        return DiffuseRows(rows, indirect, torch.arange(len(rows), device=rows.device))

    def _views(self, samples: MultiViewSamples) -> Iterator[_LitView]:
        """Yield the samples of one view after another, in the frame of its light."""
        assert self.rotations is not None and samples.image is not None
        for number, rotation in enumerate(self.rotations):
            sample = torch.nonzero(samples.image == number)[:, 0]
            if not len(sample):
                continue
            point = samples.point[sample]
            view, normal = (to_light_frame(vector, rotation).contiguous() for vector in (samples.view[sample], samples.normal[point]))
            rows, columns = self.arrays(point, self.nearest[number])
            visibility = _contiguous(self.traced.visibility[rows][:, columns])
            indirect_radiance = _contiguous(self.traced.indirect_radiance[rows][:, :, columns])
            traced = self.traced._replace(visibility=visibility, indirect_radiance=indirect_radiance)
            row = torch.arange(len(sample), device=sample.device)
            yield _LitView(sample, point, row, view, normal, traced)


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

    def transposed(self, values: torch.Tensor) -> torch.Tensor:
        """Return the sum (T, 3) over the samples of their rows times values (K, 3)."""
        return self.rows.T @ torch.zeros(len(self.rows), 3, dtype=values.dtype, device=values.device).index_add_(0, self.row, values)


@dataclass(frozen=True, eq=False)
class _LitView:
    """Samples of one view, in the frame of its light.

    Attributes:
        sample: (M,) number of each sample.
        point: (M,) its point.
        row: (M,) 0..M-1, its row in `traced`.
        view: (M, 3) unit, towards the camera.
        normal: (M, 3) unit.
        traced: as that of `RadianceTransfer`, with M rows.
    """

    sample: torch.Tensor
    point: torch.Tensor
    row: torch.Tensor
    view: torch.Tensor
    normal: torch.Tensor
    traced: TracedDirections


def _contiguous(array: Any) -> Any:
    """Return an array or tensor laid out in rows."""
    return array.contiguous() if isinstance(array, torch.Tensor) else np.ascontiguousarray(array)


def cosine_weighted(normal: torch.Tensor, traced: TracedDirections, texels: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Integrate the light of traced directions by the cosine.

    Args:
        normal: (P, 3) unit.
        traced: tensors of the transport to the P points.
        texels: number T of texels.

    Returns:
        Irradiance / pi per unit radiance of each texel, (P, T), and that of the indirect light, (P, 3).
    """
    weight = (normal @ traced.direction).clamp_min(0) * traced.solid_angle / math.pi
    irradiance = (weight * traced.visibility).view(len(normal), -1, texels).sum(1)
    return irradiance, torch.einsum("pd,pcd->pc", weight, traced.indirect_radiance)
