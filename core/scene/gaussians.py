# SPDX-License-Identifier: GPL-3.0-or-later
"""2D Gaussians: oriented surfels with radiance and materials, the parameters that the stages optimise."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from ..errors import InputError
from ..io.atomic import atomic_file
from .gbuffer import CONFIDENCE, SurfaceSamples
from .spherical_harmonics import SH_C0
from .unit_vectors import unit_vectors

SH_COEFFICIENTS = 16  # degree 3
ALBEDO, ROUGHNESS, METALLIC = slice(0, 3), 3, 4  # rows of `material`
MATERIAL = (0.5, 0.5, 0.5, 0.5, 0.02)  # of new surfels: albedo (3), roughness, metallic


def _ply_columns() -> list[str]:
    """Return the column names of 3DGS with two scales, then those of the materials."""
    sh_rest = [f"f_rest_{i}" for i in range(3 * (SH_COEFFICIENTS - 1))]
    geometry = ["opacity", "scale_0", "scale_1", "rot_0", "rot_1", "rot_2", "rot_3"]
    materials = ["albedo_r", "albedo_g", "albedo_b", "roughness", "metallic"]
    return ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *sh_rest, *geometry, *materials]


@dataclass
class Gaussians:
    """N surfels as a structure of arrays, float32, as raw (unconstrained) parameters.

    Attributes:
        position: (3, N) world.
        quaternion: (4, N) w x y z of any length; the columns of its rotation are two tangents and the normal.
        log_scale: (2, N) log of the standard deviations, world units.
        opacity: (N,) logits.
        sh: (16, 3, N) linear radiance max(0.5 + SH, 0) in the direction from the camera.
        material: (5, N) logits of albedo (3), roughness, metallic.
    """

    position: torch.Tensor
    quaternion: torch.Tensor
    log_scale: torch.Tensor
    opacity: torch.Tensor
    sh: torch.Tensor
    material: torch.Tensor

    @property
    def count(self) -> int:
        """Number of surfels, N."""
        return self.position.shape[1]

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the parameters by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def to(self, device: torch.device | str) -> Gaussians:
        """Return the surfels on a device."""
        return Gaussians(**{k: v.to(device) for k, v in self.tensors().items()})

    def select(self, index: torch.Tensor) -> Gaussians:
        """Return detached copies of the surfels at `index`: indices (M,) or a mask (N,)."""
        return Gaussians(**{k: v.detach()[..., index].clone() for k, v in self.tensors().items()})

    def joined(self, other: Gaussians) -> Gaussians:
        """Concatenate the surfels with those of another set, detached."""
        others = other.tensors()
        return Gaussians(**{k: torch.cat([v.detach(), others[k].detach()], -1) for k, v in self.tensors().items()})

    def normals(self) -> torch.Tensor:
        """Return the unit normals (3, N); their side is undefined."""
        w, x, y, z = unit_vectors(self.quaternion)
        return torch.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])

    def tangents(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the two unit tangents (3, N) of each surfel, along its first and its second scale."""
        w, x, y, z = unit_vectors(self.quaternion)
        first = torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
        return first, torch.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])

    def materials(self) -> torch.Tensor:
        """Return the materials (5, N): albedo, roughness, metallic in 0..1."""
        return self.material.sigmoid()

    def samples(self) -> SurfaceSamples:
        """Return the surfels as surface points with materials, in numpy."""
        with torch.no_grad():
            m = self.materials()
            parts = self.position.T, self.normals().T, self.opacity.sigmoid(), m[ALBEDO].T, m[ROUGHNESS], m[METALLIC]
            return SurfaceSamples(*(p.contiguous().cpu().numpy().astype(np.float32) for p in parts))


def quaternion_to(normal: torch.Tensor) -> torch.Tensor:
    """Return the quaternions (4, N) of the shortest rotations from +Z to unit normals (3, N)."""
    w = 1 + normal[2]
    flipped = w < 1e-6  # straight down: half a turn about x
    axis = torch.stack([-normal[1], normal[0], torch.zeros_like(w)])
    q = torch.cat([torch.where(flipped, 0.0, w)[None], torch.where(flipped, torch.eye(3, device=normal.device)[:, :1], axis)])
    return unit_vectors(q)


def surfels(points: np.ndarray, normals: np.ndarray, colour: np.ndarray, scale: np.ndarray, opacity: float | np.ndarray) -> Gaussians:
    """Make round surfels with constant radiance.

    Args:
        points: (N, 3) centres, world.
        normals: (N, 3) unit normals.
        colour: (N, 3) linear radiance.
        scale: (N,) standard deviation along both tangents, world units.
        opacity: one for all surfels, or (N,), in 0..1.
    """
    n = len(points)
    sh = torch.zeros(SH_COEFFICIENTS, 3, n)
    sh[0] = (torch.as_tensor(colour, dtype=torch.float32).T - 0.5) / SH_C0
    log_scale = torch.as_tensor(np.log(np.maximum(scale, 1e-12)), dtype=torch.float32)
    material = torch.logit(torch.tensor(MATERIAL))[:, None].repeat(1, n)
    normal = torch.as_tensor(normals, dtype=torch.float32).T
    position = torch.as_tensor(points, dtype=torch.float32).T.contiguous()
    opacities = torch.logit(torch.as_tensor(np.broadcast_to(opacity, n).copy(), dtype=torch.float32))
    return Gaussians(position, quaternion_to(normal), log_scale[None].repeat(2, 1), opacities, sh, material)


def save_gaussians(gaussians: Gaussians, path: Path, confidence: torch.Tensor | None = None) -> None:
    """Write a binary PLY atomically, with 3DGS's columns (raw values) and albedo, roughness, metallic in 0..1 (linear).

    Args:
        gaussians: the surfels.
        path: the PLY to write.
        confidence: (3, N) of albedo, roughness and metallic, in 0..1; None where it is not known.
    """
    with torch.no_grad():
        g = gaussians
        rest = g.sh[1:].permute(1, 0, 2).reshape(-1, g.count)  # channel by channel, as 3DGS writes them
        quaternion = unit_vectors(g.quaternion)
        known = [] if confidence is None else [confidence]
        rows = torch.cat([g.position, g.normals(), g.sh[0], rest, g.opacity[None], g.log_scale, quaternion, g.materials(), *known])
    columns = [*_ply_columns(), *(CONFIDENCE if known else ())]
    table = np.empty(g.count, [(name, "f4") for name in columns])
    for name, row in zip(columns, rows.detach().cpu().numpy(), strict=True):
        table[name] = row
    comments = ["IRGS++ 2D Gaussians; SH is linear radiance; world +Z up"]
    with atomic_file(path) as partial:
        PlyData([PlyElement.describe(table, "vertex")], comments=comments).write(str(partial))


def load_gaussians(path: Path) -> Gaussians:
    """Read the surfels that `save_gaussians` wrote.

    Raises:
        InputError: if the file is missing, broken or lacks a column.
    """
    return load_surfels(path)[0]


def load_surfels(path: Path) -> tuple[Gaussians, torch.Tensor | None]:
    """Read the surfels that `save_gaussians` wrote, and the confidence (3, N) of their materials, None where the file has none.

    Raises:
        InputError: if the file is missing, broken or lacks a column.
    """
    try:
        vertex = PlyData.read(str(path))["vertex"]
        known = set(CONFIDENCE) <= {p.name for p in vertex.properties}
        columns = [*_ply_columns(), *(CONFIDENCE if known else ())]
        rows = torch.from_numpy(np.stack([np.asarray(vertex[name], np.float32) for name in columns]))
    except (OSError, KeyError, ValueError, EOFError, RuntimeError) as error:
        raise InputError(path, f"not a PLY of 2D Gaussians ({error})") from error
    except Exception as error:  # plyfile's own parse errors share no public base but Exception
        raise InputError(path, f"not a readable PLY ({error})") from error
    if not torch.isfinite(rows).all():
        raise InputError(path, "holds values that are not finite")
    sizes = [3, 3, 3, 45, 1, 2, 4, 5, *([len(CONFIDENCE)] if known else [])]
    position, _, dc, rest, opacity, scale, quaternion, material, *confidence = rows.split(sizes)
    sh = torch.cat([dc[None], rest.reshape(3, SH_COEFFICIENTS - 1, -1).permute(1, 0, 2)])
    gaussians = Gaussians(position, quaternion, scale, opacity[0], sh.contiguous(), torch.logit(material.clamp(1e-6, 1 - 1e-6)))
    return gaussians, confidence[0].clamp(0, 1) if confidence else None
