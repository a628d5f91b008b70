# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of an object read back from a file with that of the .blend: shape, UVs, normals, material and look; and of splats."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from irgspp.core.evaluation.metrics import on_black, psnr
from irgspp.core.io.exr import read_exr
from plyfile import PlyData
from scipy.spatial import KDTree

CLOSE = 1e-3  # difference up to which two values of a material count as the same


@dataclass(frozen=True)
class Asset:
    """What a fresh Blender read from a file.

    Attributes:
        vertices: (V, 3), relative to the object's foot.
        faces: (F, 3) indices of vertices.
        normals: (F, 3, 3) unit normals of the corners.
        uvs: (F, 3, 2) of the corners.
        textures: texels that each input of the Principled BSDF reads, uint8, by its name.
        spaces: colour space of each texture, by the same names.
        values: the material's other values, by name.
        images: of the views, each (H, W, 4) linear premultiplied.
        single: the same by single scattering (GGX); empty where the material has that distribution.
        blender: version of Blender.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    textures: dict[str, np.ndarray] = field(default_factory=dict)
    spaces: dict[str, str] = field(default_factory=dict)
    values: dict[str, Any] = field(default_factory=dict)
    images: tuple[np.ndarray, ...] = ()
    single: tuple[np.ndarray, ...] = ()
    blender: str = ""


@dataclass(frozen=True)
class Difference:
    """Differences of a read-back object from the .blend.

    Attributes:
        look: PSNR in dB over the object's pixels, of the worst view.
        single: the same with the .blend's microfacet distribution.
        distance: largest distance of a vertex from the other's nearest vertex, relative to the diagonal of the bounding box.
        faces: how many more faces.
        uv: largest difference of a corner's UV.
        normal: largest angle between normals of a corner, degrees.
        texel: largest difference of a texel, in steps of 8 bits; 255 where a texture is missing or of another size.
        material: differences of the material in words.
    """

    look: float
    single: float
    distance: float
    faces: int
    uv: float
    normal: float
    texel: int
    material: tuple[str, ...]


def load_asset(folder: Path) -> Asset:
    """Read what read_child.py wrote into a folder."""
    with np.load(folder / "mesh.npz") as mesh, np.load(folder / "textures.npz") as textures:
        record = json.loads((folder / "material.json").read_text("utf-8"))
        views = {name: tuple(map(_image, sorted(folder.glob(f"{name}*.exr")))) for name in ("view", "single")}
        return Asset(**mesh, textures=dict(textures), **record, images=views["view"], single=views["single"])


def _image(file: Path) -> np.ndarray:
    channels = read_exr(file)
    return np.stack([channels[name] for name in "RGBA"], -1)


def compare(read: Asset, blend: Asset) -> Difference:
    """Compare an object that was read back with that of the .blend.

    Args:
        read: the object read back.
        blend: that of the .blend.
    """
    size = float(np.linalg.norm(np.ptp(blend.vertices, 0)))
    apart = max(KDTree(a.vertices).query(b.vertices)[0].max() for a, b in ((read, blend), (blend, read)))
    uv, normal = corner_differences(read, blend)
    return Difference(
        worst_psnr(read.images, blend.images),
        worst_psnr(read.single or read.images, blend.images),
        float(apart) / size,
        len(read.faces) - len(blend.faces),
        uv,
        normal,
        texel_difference(read.textures, blend.textures),
        tuple(material_differences(read, blend)),
    )


def worst_psnr(images: tuple[np.ndarray, ...], references: tuple[np.ndarray, ...]) -> float:
    """Return the PSNR in dB of sRGB-encoded images over black, over the pixels that show an object in either, of the worst view.

    Args:
        images: (H, W, 4) each, linear premultiplied.
        references: as many.
    """
    found = []
    for image, reference in zip(images, references, strict=True):
        found.append(psnr(on_black(image), on_black(reference), (image[..., 3] > 0) | (reference[..., 3] > 0)))
    return min(found)


def corner_differences(read: Asset, blend: Asset) -> tuple[float, float]:
    """Return the largest difference of UVs and the largest angle of normals, degrees, over corners at the same place of the same face.

    A corner is found again by its own place and the middle of its face, as files may order faces, corners and vertices in another way.

    Args:
        read: the object read back.
        blend: that of the .blend.
    """
    found = KDTree(_corners(blend)).query(_corners(read))[1]
    uv = np.abs(read.uvs.reshape(-1, 2) - blend.uvs.reshape(-1, 2)[found]).max()
    cosine = (read.normals.reshape(-1, 3) * blend.normals.reshape(-1, 3)[found]).sum(-1)
    return float(uv), float(np.degrees(np.arccos(np.clip(cosine, -1, 1).min())))


def _corners(asset: Asset) -> np.ndarray:
    """Return the place of each corner and the middle of its face, (3 F, 6)."""
    places = asset.vertices[asset.faces]
    return np.concatenate([places, np.broadcast_to(places.mean(1, keepdims=True), places.shape)], -1).reshape(-1, 6)


def texel_difference(read: dict[str, np.ndarray], blend: dict[str, np.ndarray]) -> int:
    """Return the largest difference of a texel in steps of 8 bits; 255 where a texture is missing or of another size."""
    worst = 0
    for name, texels in blend.items():
        other = read.get(name)
        if other is None or other.shape != texels.shape:
            return 255
        worst = max(worst, int(np.abs(other.astype(int) - texels).max()))
    return worst


def material_differences(read: Asset, blend: Asset) -> list[str]:
    """Return in words how a material differs: missing textures, colour spaces of data, other values of the Principled BSDF.

    Args:
        read: the object read back.
        blend: that of the .blend.
    """
    found = [f"no texture for {name}" for name in blend.spaces if name not in read.spaces]
    for name, space in read.spaces.items():
        right = ("sRGB",) if name == "Base Color" else ("Non-Color", "Raw", "Linear Rec.709")  # data, which no curve changes
        found += [] if space in right else [f"{name} is {space}"]
    for name, value in blend.values.items():
        if name not in read.values:
            found.append(f"{name} is missing")
        elif not _same(read.values[name], value):
            found.append(f"{name} {_words(read.values[name])} instead of {_words(value)}")
    return found


def wrong_columns(file: Path, read: Path) -> tuple[list[str], int]:
    """Return the names of the columns of splats that did not come back exactly, and the number of all that count.

    Args:
        file: the .ply. Its normals do not count: viewers ignore them.
        read: splats.npz of read_child.py.
    """
    written = PlyData.read(str(file))["vertex"]
    names = [one.name for one in written.properties if one.name not in ("nx", "ny", "nz")]
    with np.load(read) as found:
        return [name for name in names if name not in found or not np.array_equal(found[name], written[name])], len(names)


def _same(a: Any, b: Any) -> bool:
    return a == b if isinstance(a, str) or isinstance(b, str) else bool(np.allclose(a, b, atol=CLOSE))


def _words(value: Any) -> str:
    return value if isinstance(value, str) else str(np.round(value, 3))
