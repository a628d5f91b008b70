# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo texture of a run's mesh, sampled at the pixels of a view: the detail of full-size photographs, which the Gaussians don't have."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from ..io.quantisation import eight_bits, in_eight_bits
from ..io.srgb import decode_srgb, encode_srgb
from ..run_folder import read_run
from ..scene.mesh import Mesh
from ..scene.textures import load_texture
from ..surface.mesh_texels import texel_sides

SHARPER = 0.5  # levels by which sampling is finer than one texel per pixel: the mean of 2 x 2 texels that a lookup takes blurs by as much
MIN_SIDE = 16  # texels along a side of the coarsest level
BAND = 256  # rows, even, that are averaged or encoded at a time: as floats, a texture of 8192 texels takes 800 MB
MIN_FACING = 0.1  # least cosine between surface and view by which a pixel's size on the surface grows
_LINEAR = decode_srgb(np.arange(256, dtype=np.float32) / 255)  # linear value of each 8-bit code


class AlbedoTexture:
    """Albedo texture with levels of half the size each, looked up trilinearly.

    Args:
        texture: (T, T, 3) uint8 sRGB; row 0 is the top.
        mesh: the mesh with the texture's UVs.
        device: device that lookups come from.
    """

    def __init__(self, texture: np.ndarray, mesh: Mesh, device: torch.device | str = "cpu") -> None:
        self._levels = [torch.from_numpy(level).to(device) for level in _levels(texture)]
        self._linear = torch.from_numpy(_LINEAR).to(device)
        self._uv = torch.from_numpy(np.asarray(mesh.uvs, np.float32)).to(device)
        self._faces = torch.from_numpy(mesh.faces.astype(np.int64)).to(device)
        self._texel = torch.from_numpy(texel_sides(mesh.vertices, mesh.uvs, mesh.faces, len(texture))).to(device)

    @torch.no_grad()
    def sample(self, triangle: torch.Tensor, barycentric: torch.Tensor, pixel: torch.Tensor, facing: torch.Tensor) -> torch.Tensor:
        """Return the linear albedo (K, 3) at points of the mesh.

        Args:
            triangle: (K,) of each point.
            barycentric: (K, 3) weights of its corners.
            pixel: (K,) side of the point's pixel on a surface that faces the camera, world units.
            facing: (K,) cosine between surface and view; the size of a slanted pixel is the geometric mean of its sides.
        """
        uv = (self._uv[self._faces[triangle]] * barycentric[..., None]).sum(1)
        size = pixel / self._texel[triangle].clamp_min(1e-12) / facing.abs().clamp_min(MIN_FACING).sqrt()
        level = (size.clamp_min(1e-6).log2() - SHARPER).clamp(0, len(self._levels) - 1)
        colour = pixel.new_zeros(len(uv), 3)
        for i in range(len(self._levels)):
            weight = (1 - (level - i).abs()).clamp_min(0)
            rows = torch.nonzero(weight)[:, 0]
            colour[rows] += weight[rows, None] * self._bilinear(self._levels[i], uv[rows])
        return colour

    def _bilinear(self, image: torch.Tensor, uv: torch.Tensor) -> torch.Tensor:
        """Return the linear colours (K, 3) of an image (S, S, 3) uint8 at UVs (K, 2)."""
        side = len(image)
        place = torch.stack([uv[:, 0], 1 - uv[:, 1]], 1) * side - 0.5
        first = place.floor()
        ahead = place - first
        total = uv.new_zeros(len(uv), 3)
        for down in (0, 1):
            for right in (0, 1):
                column, row = ((first[:, axis] + step).long().clamp(0, side - 1) for axis, step in ((0, right), (1, down)))
                weight = (ahead[:, 0] if right else 1 - ahead[:, 0]) * (ahead[:, 1] if down else 1 - ahead[:, 1])
                total += weight[:, None] * self._linear[image[row, column].long()]
        return total


def load_albedo_texture(run: Path, mesh: Mesh, device: torch.device | str = "cpu") -> AlbedoTexture | None:
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
    return None if texture is None or not len(mesh.uvs) else AlbedoTexture(in_eight_bits(texture), mesh, device)


def _levels(texture: np.ndarray) -> list[np.ndarray]:
    """Return a texture (T, T, 3) uint8 and its reductions by two, averaged in linear light, down to MIN_SIDE texels."""
    levels, side = [np.array(texture)], len(texture)
    if side < 2 * MIN_SIDE or side % 2:
        return levels
    linear = np.concatenate([_halved(_LINEAR[texture[top : top + BAND]]) for top in range(0, side, BAND)])
    levels.append(_encoded(linear))
    while len(linear) >= 2 * MIN_SIDE and len(linear) % 2 == 0:
        linear = _halved(linear)
        levels.append(_encoded(linear))
    return levels


def _halved(image: np.ndarray) -> np.ndarray:
    """Return the means (h, w, 3) of 2 x 2 texels each of an image (2 h, 2 w, 3)."""
    return image.reshape(len(image) // 2, 2, image.shape[1] // 2, 2, 3).mean((1, 3), dtype=np.float32)


def _encoded(linear: np.ndarray) -> np.ndarray:
    """Encode an image (H, W, 3) as sRGB of 8 bits."""
    return np.concatenate([eight_bits(encode_srgb(linear[top : top + BAND])) for top in range(0, len(linear), BAND)])
