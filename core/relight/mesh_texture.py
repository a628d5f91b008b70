# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of a run's mesh at the pixels of a view: albedo of full-size photographs, and normals, both finer than the Gaussians'."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from ..io.quantisation import eight_bits, in_eight_bits
from ..io.srgb import decode_srgb, encode_srgb
from ..run_folder import read_run
from ..scene.mesh import Mesh
from ..scene.textures import load_texture
from ..surface.bake import tangents
from ..surface.mesh_texels import texel_sides

SHARPER = 0.5  # levels by which sampling is finer than one texel per pixel: the mean of 2 x 2 texels that a lookup takes blurs by as much
MIN_SIDE = 16  # texels along a side of the coarsest level
BAND = 256  # rows, even, that are averaged or encoded at a time: as floats, a texture of 8192 texels takes 800 MB
MIN_FACING = 0.1  # least cosine between surface and view by which a pixel's size on the surface grows


class Coding(NamedTuple):
    """What the 8-bit codes of a texture mean.

    Attributes:
        values: (256,) float32 value of each code.
        encode: codes of values (H, W, 3).
    """

    values: np.ndarray
    encode: Callable[[np.ndarray], np.ndarray]


CODES = np.arange(256, dtype=np.float32) / 255
SRGB = Coding(decode_srgb(CODES), lambda linear: eight_bits(encode_srgb(linear)))
NORMAL = Coding(2 * CODES - 1, lambda values: eight_bits(0.5 + 0.5 * values))


class MeshTexture:
    """Texture with levels of half the size each, looked up trilinearly.

    Args:
        texture: (T, T, 3) uint8; row 0 is the top.
        mesh: the mesh with the texture's UVs.
        coding: of the texture.
        device: device that lookups come from.
    """

    def __init__(self, texture: np.ndarray, mesh: Mesh, coding: Coding = SRGB, device: torch.device | str = "cpu") -> None:
        self._levels = [torch.from_numpy(level).to(device) for level in _levels(texture, coding)]
        self._values = torch.from_numpy(coding.values).to(device)
        self._uv = torch.from_numpy(np.asarray(mesh.uvs, np.float32)).to(device)
        self._faces = torch.from_numpy(mesh.faces.astype(np.int64)).to(device)
        self._texel = torch.from_numpy(texel_sides(mesh.vertices, mesh.uvs, mesh.faces, len(texture))).to(device)

    @torch.no_grad()
    def sample(self, triangle: torch.Tensor, barycentric: torch.Tensor, pixel: torch.Tensor, facing: torch.Tensor) -> torch.Tensor:
        """Return the values (K, 3) at points of the mesh.

        Args:
            triangle: (K,) of each point.
            barycentric: (K, 3) weights of its corners.
            pixel: (K,) side of the point's pixel on a surface that faces the camera, world units.
            facing: (K,) cosine between surface and view; the size of a slanted pixel is the geometric mean of its sides.
        """
        uv = (self._uv[self._faces[triangle]] * barycentric[..., None]).sum(1)
        size = pixel / self._texel[triangle].clamp_min(1e-12) / facing.abs().clamp_min(MIN_FACING).sqrt()
        level = (size.clamp_min(1e-6).log2() - SHARPER).clamp(0, len(self._levels) - 1)
        value = pixel.new_zeros(len(uv), 3)
        for i in range(len(self._levels)):
            weight = (1 - (level - i).abs()).clamp_min(0)
            rows = torch.nonzero(weight)[:, 0]
            value[rows] += weight[rows, None] * self._bilinear(self._levels[i], uv[rows])
        return value

    def _bilinear(self, image: torch.Tensor, uv: torch.Tensor) -> torch.Tensor:
        """Return the values (K, 3) of an image (S, S, 3) uint8 at UVs (K, 2)."""
        side = len(image)
        place = torch.stack([uv[:, 0], 1 - uv[:, 1]], 1) * side - 0.5
        first = place.floor()
        ahead = place - first
        total = uv.new_zeros(len(uv), 3)
        for down in (0, 1):
            for right in (0, 1):
                column, row = ((first[:, axis] + step).long().clamp(0, side - 1) for axis, step in ((0, right), (1, down)))
                weight = (ahead[:, 0] if right else 1 - ahead[:, 0]) * (ahead[:, 1] if down else 1 - ahead[:, 1])
                total += weight[:, None] * self._values[image[row, column].long()]
        return total


class NormalTexture:
    """Normal texture of a mesh in tangent space.

    Args:
        texture: (T, T, 3) uint8; row 0 is the top.
        mesh: the mesh with normals and the texture's UVs.
        device: device that lookups come from.
    """

    def __init__(self, texture: np.ndarray, mesh: Mesh, device: torch.device | str = "cpu") -> None:
        self._texture = MeshTexture(texture, mesh, NORMAL, device)
        frames = np.concatenate([mesh.normals, tangents(mesh.vertices, mesh.normals, mesh.uvs, mesh.faces)], 1)
        self._frames = torch.from_numpy(frames.astype(np.float32)).to(device)
        self._faces = torch.from_numpy(mesh.faces.astype(np.int64)).to(device)

    @torch.no_grad()
    def sample(self, triangle: torch.Tensor, barycentric: torch.Tensor, pixel: torch.Tensor, facing: torch.Tensor) -> torch.Tensor:
        """Return the unit world normals (K, 3) at points of the mesh.

        Args:
            triangle: as in `MeshTexture.sample`, like the following.
            barycentric: weights of its corners.
            pixel: side of the point's pixel.
            facing: cosine between surface and view.
        """
        corner = self._faces[triangle]
        frame = torch.einsum("kc,kca->ka", barycentric, self._frames[corner, :6])
        normal = torch.nn.functional.normalize(frame[:, :3], dim=1)
        tangent = frame[:, 3:] - (frame[:, 3:] * normal).sum(1, keepdim=True) * normal
        tangent = torch.nn.functional.normalize(tangent, dim=1)
        bitangent = self._frames[corner[:, 0], 6:] * torch.linalg.cross(normal, tangent)
        along, across, up = self._texture.sample(triangle, barycentric, pixel, facing).split(1, 1)
        return torch.nn.functional.normalize(along * tangent + across * bitangent + up * normal, dim=1)


def load_albedo_texture(run: Path, mesh: Mesh, device: torch.device | str = "cpu") -> MeshTexture | None:
    """Load the albedo texture of a run; None where it holds no detail of full-size photographs, or none was baked.

    Args:
        run: run folder.
        mesh: its mesh.
        device: device that lookups come from.

    Raises:
        InputError: if run.json or the texture can't be read.
    """
    detail = read_run(run).get("albedo_detail") if (run / "run.json").is_file() else None
    texture = load_texture(run / "textures", "albedo") if detail and detail.get("applied") else None
    return None if texture is None or not len(mesh.uvs) else MeshTexture(in_eight_bits(texture), mesh, SRGB, device)


def load_normal_texture(run: Path, mesh: Mesh, device: torch.device | str = "cpu") -> NormalTexture | None:
    """Load the normal texture of a run; None where none was baked.

    Args:
        run: run folder.
        mesh: its mesh.
        device: device that lookups come from.

    Raises:
        InputError: if the texture can't be read.
    """
    texture = load_texture(run / "textures", "normal")
    return None if texture is None or not len(mesh.uvs) else NormalTexture(in_eight_bits(texture), mesh, device)


def _levels(texture: np.ndarray, coding: Coding) -> list[np.ndarray]:
    """Return a texture (T, T, 3) uint8 and its reductions by two, averaged in values, down to MIN_SIDE texels."""
    levels, side = [np.array(texture)], len(texture)
    if side < 2 * MIN_SIDE or side % 2:
        return levels
    values = np.concatenate([_halved(coding.values[texture[top : top + BAND]]) for top in range(0, side, BAND)])
    levels.append(_encoded(values, coding))
    while len(values) >= 2 * MIN_SIDE and len(values) % 2 == 0:
        values = _halved(values)
        levels.append(_encoded(values, coding))
    return levels


def _halved(image: np.ndarray) -> np.ndarray:
    """Return the means (h, w, 3) of 2 x 2 texels each of an image (2 h, 2 w, 3)."""
    return image.reshape(len(image) // 2, 2, image.shape[1] // 2, 2, 3).mean((1, 3), dtype=np.float32)


def _encoded(values: np.ndarray, coding: Coding) -> np.ndarray:
    """Encode values (H, W, 3) in 8 bits."""
    return np.concatenate([coding.encode(values[top : top + BAND]) for top in range(0, len(values), BAND)])
