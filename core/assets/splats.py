# SPDX-License-Identifier: GPL-3.0-or-later
"""Splats: the surfels of a finished run as a PLY that viewers of 3D Gaussian splats read.

The file has the columns and conventions of 3DGS (Kerbl 2023): three scales, colours 0.5 + SH that are encoded as sRGB, and -Y up, which
viewers such as SuperSplat turn upright. A run's own gaussians.ply has two scales, linear radiance, and reflections beside the SH.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ..errors import Cancelled
from ..io.atomic import atomic_file
from ..io.srgb import encode_srgb
from ..progress.protocol import Progress
from ..rendering.deferred import radiance
from ..scene.gaussians import SH_COEFFICIENTS, Gaussians
from ..scene.mesh_ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from ..scene.spherical_harmonics import sh_basis, sh_radiance
from ..scene.unit_vectors import unit_vectors
from ..shading.sampling import point_set

DIRECTIONS = 128  # from which the radiance of each surfel is fitted: eight for each coefficient of a channel
BACK_WEIGHT = 0.02  # of directions from behind the surface, where no photograph shows the surfel: they only keep the fit bounded
THICKNESS = 0.01  # third scale of a splat as a fraction of its smaller one: flat, but a volume for viewers that invert it
CHUNK = 4096  # surfels that are fitted at a time
Y_DOWN = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # from the world (+Z up) to the file (-Y up)


def write_splats(run: Path, target: Path, progress: Progress, transform: np.ndarray | None = None) -> None:
    """Write the surfels of a finished run as splats, atomically.

    Args:
        run: folder of the finished run; its mesh tells on which side of a surfel the object's outside is.
        target: PLY to write.
        progress: asked whether to stop.
        transform: similarity (3, 3) that turns and scales the object about the run's origin; None leaves it.

    Raises:
        Cancelled: the user stopped the work; nothing is written.
        InputError: if a file of the run is missing or broken.
    """
    reconstruction, mesh = Reconstruction.load(run), load_mesh_ply(run / "mesh.ply")
    g, to_file = reconstruction.gaussians, Y_DOWN.double()
    if transform is not None:
        to_file = to_file @ torch.from_numpy(np.asarray(transform, np.float64))
    nearest = KDTree(mesh.vertices).query(g.position.T.numpy())[1]
    outward = torch.from_numpy(np.ascontiguousarray(mesh.normals[nearest].T, np.float32))
    sh = torch.empty_like(g.sh)
    for begin in range(0, g.count, CHUNK):
        if progress.cancelled:
            raise Cancelled("stopped during the export")
        part = slice(begin, min(begin + CHUNK, g.count))
        sh[..., part] = fitted_sh(reconstruction, outward[:, part], part, to_file)
    with atomic_file(target) as partial:
        _splat_table(g, sh, to_file).write(str(partial))


def fitted_sh(reconstruction: Reconstruction, outward: torch.Tensor, part: slice, to_file: torch.Tensor) -> torch.Tensor:
    """Fit SH in the file's frame to the sRGB-encoded radiance of some surfels, reflections included, by weighted least squares.

    Args:
        reconstruction: surfels and light.
        outward: (3, M) unit normals of the object's surface at the surfels.
        part: the M surfels.
        to_file: (3, 3) similarity from the world to the file's frame.

    Returns:
        (16, 3, M) coefficients of encoded radiance - 0.5 in the direction from the eye.
    """
    direction = _directions()
    colour = encode_srgb(_radiance(reconstruction, direction, part))
    weight = torch.where(outward.T @ direction < 0, 1.0, BACK_WEIGHT)
    basis = sh_basis(_rotation(to_file) @ direction, 3)
    pairs = (basis[:, None] * basis[None]).flatten(0, 1)  # products of two functions at each direction
    normal_matrix = (weight @ pairs.T).view(-1, SH_COEFFICIENTS, SH_COEFFICIENTS)
    right = torch.einsum("mk,nk,cmk->mnc", weight, basis, colour - 0.5)
    return torch.linalg.solve(normal_matrix, right).permute(1, 2, 0)


def _directions() -> torch.Tensor:
    """Return even directions (3, DIRECTIONS) from the eye, over the whole sphere."""
    u, v = point_set(DIRECTIONS).float().T
    z, angle = 1 - 2 * v, 2 * torch.pi * u
    return torch.stack([(1 - z * z).sqrt() * angle.cos(), (1 - z * z).sqrt() * angle.sin(), z])


def _radiance(reconstruction: Reconstruction, direction: torch.Tensor, part: slice) -> torch.Tensor:
    """Return the linear radiance (3, M, K) of some surfels along directions (3, K) from the eye, as the renderer shows opaque pixels."""
    g, mirrored = reconstruction.gaussians, reconstruction.mirrored()
    normal, sh = g.normals()[:, part, None], g.sh[..., part]
    count, rays = normal.shape[1], direction[:, None].expand(3, sh.shape[-1], -1)
    towards = torch.where((normal * rays).sum(0) > 0, -normal, normal)  # as the rasteriser turns normals to the eye
    colour = torch.stack([sh_radiance(sh, -one[:, None].expand(3, count)) for one in direction.T], -1)
    material = (g.materials() if mirrored is None else mirrored.material)[:, part, None].expand(5, -1, direction.shape[1])
    opaque = torch.ones(2, count, direction.shape[1])  # depth and opacity
    image = torch.cat([colour, towards, material, opaque])
    with torch.no_grad():
        return radiance(image, rays.contiguous(), None if mirrored is None else mirrored.environment)


def _splat_table(g: Gaussians, sh: torch.Tensor, to_file: torch.Tensor) -> PlyData:
    """Return the splats of surfels with SH (16, 3, N) in the file's frame, to which the similarity (3, 3) leads."""
    position, normal = to_file.float() @ g.position, _rotation(to_file) @ g.normals()
    log_scale = g.log_scale + float(_scale(to_file).log())
    thin = log_scale.min(0).values + float(np.log(THICKNESS))
    rest = sh[1:].permute(1, 0, 2).reshape(-1, g.count)  # channel by channel, as 3DGS writes them
    rows = torch.cat([position, normal, sh[0], rest, g.opacity[None], log_scale, thin[None], _turned(g.quaternion, _rotation(to_file))])
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(len(rest)))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.empty(g.count, [(name, "f4") for name in names])
    for name, row in zip(names, rows.numpy(), strict=True):
        table[name] = row
    return PlyData([PlyElement.describe(table, "vertex")], comments=["IRGS++ splats; sRGB colours; -Y up"])


def _scale(to_file: torch.Tensor) -> torch.Tensor:
    """Return the factor by which a similarity (3, 3) scales lengths."""
    return torch.linalg.det(to_file).pow(1 / 3)


def _rotation(to_file: torch.Tensor) -> torch.Tensor:
    """Return the rotation (3, 3) float32 of a similarity (3, 3)."""
    return (to_file / _scale(to_file)).float()


def _turned(quaternion: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """Return unit quaternions w x y z (4, N) of rotations (4, N) followed by another one (3, 3)."""
    x, y, z, w = Rotation.from_matrix(rotation.numpy()).as_quat()
    left = torch.tensor([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]], dtype=torch.float32)
    return left @ unit_vectors(quaternion)
