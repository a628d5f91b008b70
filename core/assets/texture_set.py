# SPDX-License-Identifier: GPL-3.0-or-later
"""Set of textures that production tools take: separate maps, occlusion-roughness-metallic in one, normals as OpenGL or DirectX has them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.quantisation import bits_of, in_eight_bits, quantised
from ..run_folder import read_run
from ..scene.mesh import Mesh
from ..scene.textures import CHANNELS, OPTIONAL, SIXTEEN_BITS, load_textures, occlusion_roughness_metallic, save_textures
from ..scene.udim import tile_images
from .occlusion import occlusion_texture

NORMAL_MAPS = ("opengl", "directx")  # +Y up, and +Y down


def save_texture_set(
    run: Path, folder: Path, normal_map: str = "opengl", eight: bool = False, occluded: Mesh | None = None, tiles: int = 1
) -> None:
    """Write albedo (sRGB), roughness, metallic, normal, orm (red occlusion, green roughness, blue metallic), confidences as PNG files.

    They have the bits of the run's textures. A run with heights also gives height.png, and height.json with their scale and midlevel.

    Args:
        run: folder of the finished run.
        folder: to write to.
        normal_map: "opengl" or "directx", whose green channel is the inverse.
        eight: True to write 8 bits always, but for heights.
        occluded: mesh whose occlusion is written as occlusion.png and into red of orm.png; None for none.
        tiles: UDIM tiles along a side, into which all are sliced: albedo.1001.png and so on.

    Raises:
        InputError: if the run lacks a texture, or the scale of its heights.
    """
    textures = load_textures(run / "textures")
    missing = [name for name in CHANNELS if name not in textures and name not in OPTIONAL]
    if missing:
        raise InputError(run / "textures", f"lacks {', '.join(f'{name}.png' for name in missing)}", "bake the run again")
    if eight:
        textures = {name: texture if name in SIXTEEN_BITS else in_eight_bits(texture) for name, texture in textures.items()}
    if occluded is not None:
        textures["occlusion"] = occlusion_of(occluded, textures)
    textures["orm"] = occlusion_roughness_metallic(textures)
    if normal_map == "directx":
        textures["normal"] = flipped_green(textures["normal"])
    save_textures(textures if tiles == 1 else tile_images(textures, tiles), folder)
    if "height" in textures:
        record = read_run(run).get("height")
        if record is None:
            raise InputError(run / "run.json", "lacks the scale of textures/height.png", "bake the run again")
        (folder / "height.json").write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def occlusion_of(mesh: Mesh, textures: dict[str, np.ndarray]) -> np.ndarray:
    """Trace a mesh's occlusion in the size and type of its textures.

    Args:
        mesh: with UVs.
        textures: of the mesh.

    Returns:
        (T, T) uint8 or uint16, the highest value where nothing occludes.
    """
    roughness = textures["roughness"]
    return quantised(occlusion_texture(mesh, len(roughness)), bits_of(roughness))


def flipped_green(normal: np.ndarray) -> np.ndarray:
    """Convert a normal map (T, T, 3) uint8 or uint16 between OpenGL's and DirectX's direction of +Y."""
    flipped = normal.copy()
    flipped[..., 1] = np.iinfo(normal.dtype).max - flipped[..., 1]
    return flipped
