# SPDX-License-Identifier: GPL-3.0-or-later
"""What files beside an image say is true of it, format by format, in the dataset's own frame and units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.exr import MAX_PIXELS
from ..io.image import read_image, unit
from ..io.safe_paths import inside
from ..io.srgb import decode_srgb
from ..scene.dataset import View
from .formats import glossy_synthetic, stanford_orb

# From a map's axes (+Z up, -X at the edges) to those of a camera that has -Z in the middle and +X on the right of its map, as skylibs has.
MAP_TO_CAMERA = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])


@dataclass(frozen=True, eq=False)
class MapFile:
    """A lat-long light map: its file, and the (3, 3) rotation from the axes of a map of ours to the dataset's own frame."""

    path: Path
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class Layers:
    """What is stated of one view, at the size of its files; None or missing where nothing is.

    Attributes:
        albedo: (H, W, 3) linear; normal: (H, W, 3) in the dataset's frame, of any length; depth: (H, W) planar, 0 = nothing there.
        roughness: (H, W).
        cover: (H, W) 0..1 where albedo and roughness count, or None: where they are not 0.
        relit: light name -> file of the same view under it.
        lights: light name -> map of this view's own.
    """

    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    roughness: np.ndarray | None = None
    cover: np.ndarray | None = None
    relit: dict[str, Path] = field(default_factory=dict)
    lights: dict[str, MapFile] = field(default_factory=dict)


def ground_truth_layers(format: str, view: View) -> Layers:
    """What lies beside the image of a view of a dataset of that format. Raises InputError where a file is damaged."""
    return READERS.get(format, lambda _: Layers())(view)


def relit_names(format: str, image: Path) -> list[str]:
    """The lights under which there are images of the same view."""
    if format == "tensoir":
        return list(_tensoir_relit(image))
    return list(_synthetic4relight_relit(image)) if format == "synthetic4relight" else []


def light_files(format: str, folder: Path, relit: list[str]) -> tuple[str | None, dict[str, MapFile]]:
    """(name of the training light where it is known, light name -> map) of a dataset's folder; `relit` are the lights of its images."""
    if format == "tensoir":
        return _found("sunset", [*relit, "sunset"], TENSOIR_MAPS, folder)
    if format == "synthetic4relight":
        return _found("envmap3", ["envmap3", *relit], ("envmaps", "Environment_Maps"), folder)
    if format == "glossy-synthetic":
        return None, {n: MapFile(f, glossy_synthetic.Y_UP[:3, :3].T) for n, f in glossy_synthetic.light_files(folder).items()}
    return None, {}


TENSOIR_MAPS = tuple(f"{place}high_res_envmaps_{size}" for size in ("2k", "1k") for place in ("Environment_Maps/", "", "light_probes/"))


def _found(train: str, names: list[str], places: tuple[str, ...], folder: Path) -> tuple[str | None, dict[str, MapFile]]:
    """Maps of these names in folders of these names, in the dataset's or up to two above it."""
    homes = [parent / place for place in places for parent in (folder, *list(folder.resolve().parents)[:2])]
    files = {n: next((f for h in homes for s in (".hdr", ".exr") if (f := h / (n + s)).is_file()), None) for n in names}
    found = {name: MapFile(inside(file, file.parent)) for name, file in files.items() if file is not None}
    return (train if train in found else None), found


def _tensoir(view: View) -> Layers:
    folder = view.path.parent
    albedo, cover = _png(folder / "albedo.png")  # linear as it is stored
    return Layers(albedo, _png_normal(folder / "normal.png"), cover=cover, relit=_tensoir_relit(view.path))


def _tensoir_relit(image: Path) -> dict[str, Path]:
    return {f.stem.removeprefix("rgba_"): inside(f, image.parent) for f in sorted(image.parent.glob("rgba_*.png"))}


def _synthetic4relight(view: View) -> Layers:
    name = view.path.name.removesuffix("_rgba.png")
    albedo, cover = _png(view.path.with_name(name + "_albedo.png"))
    roughness, _ = _png(view.path.with_name(name + "_rough.png"))
    return Layers(
        albedo=None if albedo is None else decode_srgb(albedo),
        roughness=None if roughness is None else roughness[..., 0],
        cover=cover,
        relit=_synthetic4relight_relit(view.path),
    )


def _synthetic4relight_relit(image: Path) -> dict[str, Path]:
    name = image.name.removesuffix("_rgba.png")
    files = sorted((image.parent.parent / "test_rli").glob(f"envmap*_{name}.png"))
    return {f.stem.removesuffix("_" + name): inside(f, image.parent.parent) for f in files}


def _glossy_synthetic(view: View) -> Layers:
    share, _ = _png(glossy_synthetic.depth_of(view.path))
    if share is None:
        return Layers()
    depth = share[..., 0] * glossy_synthetic.DEPTH_RANGE
    return Layers(depth=np.where(depth < glossy_synthetic.FAR, depth, 0))


def _stanford_orb(view: View) -> Layers:
    """The frame of these scenes is ours, so the view's camera says how what is stored in the camera's frame is turned."""
    folder, name, turn = stanford_orb.truth_folder(view.path), view.path.stem, view.camera.to_world[:3, :3]
    light = inside(folder / "env_map" / f"{name}.exr", folder)
    lights = {folder.name: MapFile(light, turn @ MAP_TO_CAMERA)} if light.is_file() else {}
    if view.light is not None:
        return Layers(lights=lights)
    albedo, _ = _png(folder / "pseudo_gt_albedo" / f"{name}.png")
    normal, depth = (_npy(folder / kind / f"{name}.npy") for kind in ("surface_normal", "z_depth"))
    return Layers(
        albedo=_npy(folder / "pseudo_gt_albedo" / f"{name}.npy") if albedo is None else decode_srgb(albedo),
        normal=None if normal is None else normal @ turn.T.astype(np.float32),
        depth=None if depth is None else np.maximum(depth, 0),  # -1 where nothing is
        lights=lights,
    )


def _nerf_synthetic(view: View) -> Layers:
    """Shiny Blender's scenes have normals; the depth and normal images of NeRF's own are of no known scale."""
    return Layers(normal=_png_normal(view.path.with_name(view.path.stem + "_normal.png")))


READERS: dict[str, Callable[[View], Layers]] = {
    "tensoir": _tensoir,
    "synthetic4relight": _synthetic4relight,
    "glossy-synthetic": _glossy_synthetic,
    "stanford-orb": _stanford_orb,
    "nerf-synthetic": _nerf_synthetic,
}


def _png(path: Path) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(H, W, 3) float32 as stored, 0..1, and alpha (H, W); None where there is no such file, or no alpha in it."""
    if not path.is_file():
        return None, None
    image = read_image(inside(path, path.parent))
    return unit(image.colour), None if image.alpha is None else unit(image.alpha)


def _png_normal(path: Path) -> np.ndarray | None:
    """(H, W, 3) vectors stored as colours, 0 where the image is transparent or black, or None where there is no such file."""
    colour, alpha = _png(path)
    if colour is None:
        return None
    there = colour.max(-1) > 0 if alpha is None else alpha > 0
    return np.where(there[..., None], 2 * colour - 1, 0)


def _npy(path: Path) -> np.ndarray | None:
    """(H, W) or (H, W, 3) float32, or None where there is no such file."""
    if not path.is_file():
        return None
    inside(path, path.parent)
    try:  # mapped: a header that promises more than the file has is found out here
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # numpy raises OSError, ValueError, EOFError, SyntaxError, ... for broken files
        raise InputError(path, f"not a readable array ({type(error).__name__}: {error})") from error
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if array.dtype.kind != "f" or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,)) or array.size > 3 * MAX_PIXELS:
        raise InputError(path, f"is no map of numbers but {array.dtype} {array.shape}")
    return np.nan_to_num(np.array(array, np.float32))
