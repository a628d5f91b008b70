# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground truth of each format, read from the files next to the images, in the dataset's own frame and units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io.exr import MAX_PIXELS
from ..io.image import read_image, to_unit_range
from ..io.safe_paths import inside
from ..io.srgb import decode_srgb
from ..scene.dataset import View
from .formats import glossy_synthetic, stanford_orb

# From the axes of a map (+Z up, -X at the edges) to those of a camera whose map has -Z in the middle and +X on the right, as in skylibs.
MAP_TO_CAMERA = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])


@dataclass(frozen=True, eq=False)
class MapFile:
    """Lat-long environment map as a file.

    Attributes:
        path: the file.
        turn: (3, 3) rotation from the axes of the map (see `core.scene.environment_map`) to the dataset's own frame.
    """

    path: Path
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))


@dataclass(frozen=True, eq=False)
class GroundTruthLayers:
    """Ground truth of one view at the size of its files; None or missing where the dataset has none.

    Attributes:
        albedo: (H, W, 3) linear.
        normal: (H, W, 3) in the dataset's frame, of any length.
        depth: (H, W) planar, 0 where there is no surface.
        roughness: (H, W).
        cover: (H, W) in 0..1, weight of albedo and roughness; None means where they are not 0.
        relit: light name -> file of the same view under it.
        lights: light name -> environment map of this view alone.
    """

    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    roughness: np.ndarray | None = None
    cover: np.ndarray | None = None
    relit: dict[str, Path] = field(default_factory=dict)
    lights: dict[str, MapFile] = field(default_factory=dict)


def ground_truth_layers(format: str, view: View) -> GroundTruthLayers:
    """Read the ground truth next to the image of a view.

    Args:
        format: short name of the dataset's format.
        view: a view of the dataset.

    Raises:
        InputError: if a file is damaged.
    """
    return READERS.get(format, lambda _: GroundTruthLayers())(view)


def relit_names(format: str, image: Path) -> list[str]:
    """List the lights under which there are further images of the same view.

    Args:
        format: short name of the dataset's format.
        image: the view's file.
    """
    if format == "tensoir":
        return list(_tensoir_relit(image))
    return list(_synthetic4relight_relit(image)) if format == "synthetic4relight" else []


def light_files(format: str, folder: Path, relit: list[str]) -> tuple[str | None, dict[str, MapFile]]:
    """Find the environment maps of a dataset.

    Args:
        format: short name of the dataset's format.
        folder: the dataset's folder.
        relit: names of the lights of its relit images.

    Returns:
        The name of the training light if its map was found, else None; and light name -> map.
    """
    if format == "tensoir":
        return _find_maps("sunset", [*relit, "sunset"], TENSOIR_MAPS, folder)
    if format == "synthetic4relight":
        return _find_maps("envmap3", ["envmap3", *relit], ("envmaps", "Environment_Maps"), folder)
    if format == "glossy-synthetic":
        return None, {n: MapFile(f, glossy_synthetic.Y_UP[:3, :3].T) for n, f in glossy_synthetic.light_files(folder).items()}
    return None, {}


TENSOIR_MAPS = tuple(f"{place}high_res_envmaps_{size}" for size in ("2k", "1k") for place in ("Environment_Maps/", "", "light_probes/"))


def _find_maps(train: str, names: list[str], places: tuple[str, ...], folder: Path) -> tuple[str | None, dict[str, MapFile]]:
    """Find maps by name in folders of the names `places`, which are in the dataset's folder or up to two levels above it."""
    folders = [parent / place for place in places for parent in (folder, *list(folder.resolve().parents)[:2])]
    files = {n: next((f for h in folders for s in (".hdr", ".exr") if (f := h / (n + s)).is_file()), None) for n in names}
    found = {name: MapFile(inside(file, file.parent)) for name, file in files.items() if file is not None}
    return (train if train in found else None), found


def _tensoir(view: View) -> GroundTruthLayers:
    folder = view.path.parent
    albedo, cover = _png(folder / "albedo.png")  # linear as it is stored
    return GroundTruthLayers(albedo, _png_normal(folder / "normal.png"), cover=cover, relit=_tensoir_relit(view.path))


def _tensoir_relit(image: Path) -> dict[str, Path]:
    return {f.stem.removeprefix("rgba_"): inside(f, image.parent) for f in sorted(image.parent.glob("rgba_*.png"))}


def _synthetic4relight(view: View) -> GroundTruthLayers:
    name = view.path.name.removesuffix("_rgba.png")
    albedo, cover = _png(view.path.with_name(name + "_albedo.png"))
    roughness, _ = _png(view.path.with_name(name + "_rough.png"))
    return GroundTruthLayers(
        albedo=None if albedo is None else decode_srgb(albedo),
        roughness=None if roughness is None else roughness[..., 0],
        cover=cover,
        relit=_synthetic4relight_relit(view.path),
    )


def _synthetic4relight_relit(image: Path) -> dict[str, Path]:
    name = image.name.removesuffix("_rgba.png")
    files = sorted((image.parent.parent / "test_rli").glob(f"envmap*_{name}.png"))
    return {f.stem.removesuffix("_" + name): inside(f, image.parent.parent) for f in files}


def _glossy_synthetic(view: View) -> GroundTruthLayers:
    fraction, _ = _png(glossy_synthetic.depth_map_of(view.path))
    if fraction is None:
        return GroundTruthLayers()
    depth = fraction[..., 0] * glossy_synthetic.DEPTH_RANGE
    return GroundTruthLayers(depth=np.where(depth < glossy_synthetic.FAR, depth, 0))


def _stanford_orb(view: View) -> GroundTruthLayers:
    """Read the ground truth of Stanford-ORB; layers stored in the camera's frame are rotated by the pose, since its frame is the world."""
    folder, name, turn = stanford_orb.ground_truth_folder(view.path), view.path.stem, view.camera.to_world[:3, :3]
    light = inside(folder / "env_map" / f"{name}.exr", folder)
    lights = {folder.name: MapFile(light, turn @ MAP_TO_CAMERA)} if light.is_file() else {}
    if view.light is not None:
        return GroundTruthLayers(lights=lights)
    albedo, _ = _png(folder / "pseudo_gt_albedo" / f"{name}.png")
    normal, depth = (_npy(folder / kind / f"{name}.npy") for kind in ("surface_normal", "z_depth"))
    return GroundTruthLayers(
        albedo=_npy(folder / "pseudo_gt_albedo" / f"{name}.npy") if albedo is None else decode_srgb(albedo),
        normal=None if normal is None else normal @ turn.T.astype(np.float32),
        depth=None if depth is None else np.maximum(depth, 0),  # -1 where there is no surface
        lights=lights,
    )


def _nerf_synthetic(view: View) -> GroundTruthLayers:
    """Read the normals of Shiny Blender's scenes; the depth and normal images of NeRF's own scenes are of unknown scale."""
    return GroundTruthLayers(normal=_png_normal(view.path.with_name(view.path.stem + "_normal.png")))


READERS: dict[str, Callable[[View], GroundTruthLayers]] = {
    "tensoir": _tensoir,
    "synthetic4relight": _synthetic4relight,
    "glossy-synthetic": _glossy_synthetic,
    "stanford-orb": _stanford_orb,
    "nerf-synthetic": _nerf_synthetic,
}


def _png(path: Path) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Read colour (H, W, 3) float32 in 0..1 as stored and alpha (H, W); None if the file does not exist or has no alpha."""
    if not path.is_file():
        return None, None
    image = read_image(inside(path, path.parent))
    return to_unit_range(image.colour), None if image.alpha is None else to_unit_range(image.alpha)


def _png_normal(path: Path) -> np.ndarray | None:
    """Read vectors (H, W, 3) stored as colours, 0 where the image is transparent or black; None if the file does not exist."""
    colour, alpha = _png(path)
    if colour is None:
        return None
    covered = colour.max(-1) > 0 if alpha is None else alpha > 0
    return np.where(covered[..., None], 2 * colour - 1, 0)


def _npy(path: Path) -> np.ndarray | None:
    """Read an array (H, W) or (H, W, 3) float32; None if the file does not exist."""
    if not path.is_file():
        return None
    inside(path, path.parent)
    try:  # mapped, so that a header that claims more than the file has raises an error here
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # numpy raises OSError, ValueError, EOFError, SyntaxError, ... for broken files
        raise InputError(path, f"not a readable array ({type(error).__name__}: {error})") from error
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if array.dtype.kind != "f" or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,)) or array.size > 3 * MAX_PIXELS:
        raise InputError(path, f"is not an image of floats but {array.dtype} {array.shape}")
    return np.nan_to_num(np.array(array, np.float32))
