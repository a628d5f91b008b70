# SPDX-License-Identifier: GPL-3.0-or-later
"""Choices of an export, and the formats that can have them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError

ASSETS = (".glb", ".usd", ".usdc", ".usda", ".usdz", ".obj", ".fbx")  # the object for other programs
PARTS = (".ply", ".exr")  # splats and light
SUFFIXES = (*ASSETS, ".blend", *PARTS)
BESIDE = (".usd", ".usdc", ".usda", ".obj")  # whose files hold no textures
APART = ("beside", "tiles")  # choices of textures in files of their own
INSIDE = (".glb", ".usdz")  # whose files hold their textures always
SIMILAR = (".blend", ".ply")  # whose cameras and splats can't be stretched
UNTURNED = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
SLACK = 1e-3  # unequal scale of the axes that counts as equal, relative to the scale
LEVELS = (0.5, 0.25)  # fraction of the triangles in NAME_LOD1 and NAME_LOD2
OPENGL_ONLY = (".glb", ".usd", ".usdc", ".usda", ".usdz", ".blend")  # whose normal maps are OpenGL's by definition


@dataclass(frozen=True)
class AssetOptions:
    """Choices of an export.

    Attributes:
        lods: True to add NAME_LOD1 and NAME_LOD2 with a half and a quarter of the triangles, which share the textures.
        collision: True to add convex hulls UCX_NAME_00 and so on; UCX_NAME_LOD0_00 with levels of detail.
        textures: "packed" into the file, "beside" it in the folder NAME_textures, "tiles": beside it as UDIM tiles, or "auto": packed where
            the format can. A .blend has the run's tiles always, other files with "tiles" alone: no other format reads them everywhere.
        normal_map: "opengl" or "directx".
        transform: rows of the matrix (3, 3) that turns and scales the object before it is put on its foot.
        occlusion: True to trace ambient occlusion, into red of orm.png beside the file, or the occlusion texture of a .glb.
    """

    lods: bool = False
    collision: bool = False
    textures: str = "auto"
    normal_map: str = "opengl"
    transform: tuple[float, ...] = UNTURNED
    occlusion: bool = False

    def fitting(self, suffix: str) -> AssetOptions:
        """Return the choices with the defaults in place of those that files with this suffix can't have."""
        if suffix in PARTS:
            return AssetOptions(transform=self.transform if suffix == ".ply" else UNTURNED)
        unfit = (BESIDE, "packed"), (INSIDE, "beside"), (INSIDE, "tiles")
        textures = "auto" if any(suffix in formats and self.textures == choice for formats, choice in unfit) else self.textures
        normal_map = "opengl" if suffix in OPENGL_ONLY else self.normal_map
        return replace(self, textures=textures, normal_map=normal_map, occlusion=self.occlusion and _holds_occlusion(suffix, textures))

    def matrix(self, suffix: str) -> np.ndarray:
        """Return the transform as a matrix (3, 3).

        Raises:
            InputError: if it mirrors or flattens, or stretches what a file with this suffix holds.
        """
        matrix = np.array(self.transform, float).reshape(3, 3)
        size = float(np.linalg.det(matrix))
        if not np.isfinite(matrix).all() or size <= 0:
            raise InputError("transform", "mirrors the object or gives it no size", "give its axes positive scales")
        if suffix in SIMILAR and np.abs(matrix.T @ matrix - size ** (2 / 3) * np.eye(3)).max() > SLACK * size ** (2 / 3):
            raise InputError("transform", f"stretches the object, which {suffix} can't be", "give its axes one equal scale")
        return matrix

    def packs(self, suffix: str) -> bool:
        """Return True where textures are packed into a file with this suffix.

        Raises:
            InputError: if the format can't have them as chosen, or has no DirectX normal maps.
        """
        if self.textures == "packed" and suffix in BESIDE:
            raise InputError("--textures", f"{suffix} holds no textures", "use beside, or a .glb, .usdz, .fbx or .blend")
        if self.textures in APART and suffix in INSIDE:
            raise InputError("--textures", f"{suffix} always holds its textures", "use packed, or a .usdc, .fbx, .obj or .blend")
        if self.normal_map == "directx" and suffix in OPENGL_ONLY:
            raise InputError("--normal-map", f"the normal maps of {suffix} are OpenGL's by definition", "use opengl, or a .fbx or .obj")
        if self.occlusion and not _holds_occlusion(suffix, self.textures):
            raise InputError("--occlusion", f"{suffix} has no place for it", "use --textures beside, or a .glb")
        return suffix not in BESIDE and self.textures not in APART

    def tiles(self, suffix: str, tiles: int) -> int:
        """Return the UDIM tiles along a side that a file with this suffix has.

        Args:
            suffix: of the file.
            tiles: of the run, along a side.

        Raises:
            InputError: if tiles are asked for and the run has none.
        """
        if self.textures == "tiles" and tiles == 1:
            raise InputError(
                "--textures", "the run has no UDIM tiles", "bake them first: irgspp bake RUN --udim 2, or UDIM Tiles under Bake Again"
            )
        return tiles if suffix == ".blend" or self.textures == "tiles" else 1


def _holds_occlusion(suffix: str, textures: str) -> bool:
    """Return True where a file has an occlusion texture, or a folder of textures beside it that can have one."""
    return suffix == ".glb" or suffix in BESIDE or (suffix not in INSIDE and textures in APART)
