# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of a mesh as PNG files, and packed for glTF."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from ..errors import InputError
from ..io.atomic import atomic_file
from ..io.image import decode_deep_png, png_bits
from ..io.quantisation import bits_of

CHANNELS = {"albedo": 3, "roughness": 1, "metallic": 1, "normal": 3, "confidence": 1, "material_confidence": 3, "height": 1}
OPTIONAL = ("confidence", "material_confidence", "height")  # that older runs lack, or that were not measured
SIXTEEN_BITS = ("height",)  # whose values are always uint16; those of the others are uint8 or uint16


def save_textures(textures: dict[str, np.ndarray], folder: Path) -> None:
    """Write each texture as folder/<name>.png, each atomically.

    Args:
        textures: (T, T, 3) or (T, T) by name, as in `Mesh.textures`.
        folder: the folder, which is created if it does not exist.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, texture in textures.items():
        with atomic_file(folder / f"{name}.png") as partial:
            _save_png(texture, partial)


def _save_png(texture: np.ndarray, path: Path) -> None:
    """Write a texture (T, T, 3) or (T, T), uint8 or uint16, as PNG of as many bits."""
    if texture.ndim == 3 and bits_of(texture) == 16:  # which Pillow does not write
        path.write_bytes(cv2.imencode(".png", cv2.cvtColor(texture, cv2.COLOR_RGB2BGR))[1].tobytes())
    else:
        Image.fromarray(texture).save(path, "PNG")


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
            if name in SIXTEEN_BITS or png_bits(path) == 16:
                return _sixteen_bits(image, path, channels)
            return np.asarray(image.convert("RGB" if channels == 3 else "L"))
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(path, f"not a readable image ({error})") from error


def _sixteen_bits(image: Image.Image, path: Path, channels: int) -> np.ndarray:
    """Return an image as (T, T, 3) or (T, T) uint16; PIL's conversions would cut it to 8 bits."""
    if png_bits(path) != 16:
        raise ValueError(f"its values are {image.mode}, not 16 bits")
    image.load()  # OpenCV returns half an image of a truncated file
    pixels = decode_deep_png(path.read_bytes())
    if pixels.ndim != (3 if channels == 3 else 2) or pixels.shape[2:] not in ((), (3,)):
        raise ValueError(f"it has the shape {pixels.shape}, not {channels} channels")
    return pixels


def occlusion_roughness_metallic(textures: dict[str, np.ndarray]) -> np.ndarray:
    """Pack roughness and metallic (T, T) for glTF into (T, T, 3) of the same type: R "occlusion" (none if not there), G, B metallic."""
    roughness, metallic = textures["roughness"], textures["metallic"]
    occlusion = textures.get("occlusion", np.full_like(roughness, np.iinfo(roughness.dtype).max))
    return np.stack([occlusion, roughness, metallic], -1)
