# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of a mesh as PNG files, and packed for glTF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from ..errors import InputError
from ..io.atomic import atomic_file

CHANNELS = {"albedo": 3, "roughness": 1, "metallic": 1, "normal": 3, "confidence": 1, "material_confidence": 3, "height": 1}
OPTIONAL = ("confidence", "material_confidence", "height")  # that older runs lack, or that were not measured
SIXTEEN_BITS = ("height",)  # whose values are uint16


def save_textures(textures: dict[str, np.ndarray], folder: Path) -> None:
    """Write each texture as folder/<name>.png, each atomically.

    Args:
        textures: (T, T, 3) or (T, T) by name, as in `Mesh.textures`.
        folder: the folder, which is created if it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, texture in textures.items():
        with atomic_file(folder / f"{name}.png") as partial:
            Image.fromarray(texture).save(partial)


def load_textures(folder: Path) -> dict[str, np.ndarray]:
    """Read the textures in a folder, by name as in `Mesh.textures`; missing ones are left out.

    Raises:
        InputError: if a texture can't be read.
    """
    found = {name: load_texture(folder, name) for name in CHANNELS}
    return {name: texture for name, texture in found.items() if texture is not None}


def load_texture(folder: Path, name: str) -> np.ndarray | None:
    """Read one texture in a folder, as in `Mesh.textures`; return None where it is missing.

    Args:
        folder: the folder.
        name: one of CHANNELS.

    Raises:
        InputError: if it can't be read.
    """
    path, channels = folder / f"{name}.png", CHANNELS[name]
    if not path.exists():
        return None
    try:
        with Image.open(path) as image:
            if name in SIXTEEN_BITS:
                return _sixteen_bits(image)
            return np.asarray(image.convert("RGB" if channels == 3 else "L"))
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(path, f"not a readable image ({error})") from error


def _sixteen_bits(image: Image.Image) -> np.ndarray:
    """Return an image of one channel as (T, T) uint16; PIL's conversions would cut it to 8 bits."""
    if not image.mode.startswith("I"):
        raise ValueError(f"its values are {image.mode}, not 16 bits")
    return np.asarray(image).astype(np.uint16)


def occlusion_roughness_metallic(textures: dict[str, np.ndarray]) -> np.ndarray:
    """Pack roughness and metallic (T, T) uint8 for glTF into (T, T, 3) uint8: R occlusion (none), G roughness, B metallic."""
    roughness, metallic = textures["roughness"], textures["metallic"]
    return np.stack([np.full_like(roughness, 255), roughness, metallic], -1)
