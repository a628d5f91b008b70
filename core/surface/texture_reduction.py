# SPDX-License-Identifier: GPL-3.0-or-later
"""Reduction of baked textures to a smaller size by averages over areas, without mixing in texels that lie outside the charts."""

from __future__ import annotations

import cv2
import numpy as np

from ..io.quantisation import bits_of, quantised, srgb_quantised
from ..io.srgb import decode_srgb
from ..scene.mesh import Mesh
from .mesh_texels import CoveredTexels, texel_owners
from .meshing import unit


def reduced_textures(mesh: Mesh, size: int) -> dict[str, np.ndarray]:
    """Return the textures of a mesh at a smaller size.

    Albedo is averaged in linear light, normals as vectors that are then of unit length again, all others as they are.

    Args:
        mesh: with UVs and textures (S, S) or (S, S, 3) uint8 or uint16 of one size S.
        size: texels along a side, 1 to S.

    Returns:
        Textures by name, (size, size) or (size, size, 3) of the same type; texels outside all triangles take the nearest value.
    """
    side = len(mesh.textures["albedo"])
    covered = (texel_owners(mesh.uvs, mesh.faces, side)[1] >= 0).astype(np.float32)
    share = _area_means(covered, size)
    texels = CoveredTexels(size, np.flatnonzero(share > 0).astype(np.int32))
    return {name: texels.image(_reduced(name, texture, covered, share)) for name, texture in mesh.textures.items()}


def _reduced(name: str, texture: np.ndarray, covered: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return the averages (P, ...) of a texture over the covered part of each texel whose covered share is not 0."""
    size, known = len(share), share > 0
    highest = np.iinfo(texture.dtype).max
    levels = np.arange(highest + 1, dtype=np.float32) / highest
    if name == "albedo":
        levels = decode_srgb(levels).astype(np.float32)
    channels = texture[..., None] if texture.ndim == 2 else texture
    # One channel after another: three at once would take three times the memory.
    sums = [_area_means(levels[channels[..., c]] * covered, size)[known] for c in range(channels.shape[-1])]
    means = np.stack(sums, -1) / share[known][:, None]
    if name == "normal":
        return quantised(0.5 + 0.5 * unit(2 * means - 1), bits_of(texture))
    encoded = (srgb_quantised if name == "albedo" else quantised)(means, bits_of(texture))
    return encoded[:, 0] if texture.ndim == 2 else encoded


def _area_means(image: np.ndarray, size: int) -> np.ndarray:
    """Return the means of an image (S, S) float32 over the areas of size * size texels."""
    return np.asarray(cv2.resize(image, (size, size), interpolation=cv2.INTER_AREA))
