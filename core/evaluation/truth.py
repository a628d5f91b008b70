# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground truth that lies beside the pictures of a rendered dataset, brought into the world of a run."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from ..datasets.dataset import View
from ..datasets.picture import read_picture, unit
from ..errors import InputError
from ..scene.exr import read_exr, read_exr_rgb
from ..shading.lightmap import lookup, texel_directions


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known of one view; None or missing where nothing is.

    Attributes:
        picture: (H, W, 3) encoded, times alpha, above 1 where the file is HDR; `alpha` (H, W), ones where the dataset has none.
        albedo: (H, W, 3) linear; normal: (H, W, 3) unit, in the world of the run; depth: (H, W) planar, 0 = nothing there.
        roughness, metallic: (H, W).
        relit: light name -> (H, W, 3) encoded, times that picture's alpha, above 1 where the file is HDR.
    """

    picture: np.ndarray
    alpha: np.ndarray
    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    roughness: np.ndarray | None = None
    metallic: np.ndarray | None = None
    relit: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def object(self) -> np.ndarray:
        """(H, W) pixels that are inside the object for certain."""
        inside = self.alpha > 0.99
        return inside if self.depth is None else inside & (self.depth > 0)


@dataclass(frozen=True, eq=False)
class SceneTruth:
    """What a rendered dataset says of the whole scene: lights by name (the training light's name apart), constants, surface samples."""

    train_light: str | None = None
    lights: dict[str, np.ndarray] = field(default_factory=dict)
    constants: tuple[float, float] | None = None  # roughness, metallic of a scene of one plain material
    points: tuple[np.ndarray, np.ndarray] | None = None  # positions and normals


def load_scene_truth(dataset: Path, to_world: np.ndarray) -> SceneTruth:
    """Read meta.json, envs/ and surface_points.npz of a dataset folder, as far as they are there; `to_world` leads to the run's world."""
    folder = dataset if dataset.is_dir() else dataset.parent
    file = folder / "meta.json"
    if not file.is_file():
        return SceneTruth()
    try:
        meta = json.loads(file.read_text(encoding="utf-8"))
        train, relights = meta.get("train_light"), list(meta.get("relights", []))
        materials = [m for m in dict(meta.get("materials", {})).values() if isinstance(m, dict)]
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(file, f"is not the description of a rendered dataset ({error})") from error
    files = {name: folder / "envs" / f"{name}.exr" for name in [train, *relights] if name}
    lights = {name: turned(read_exr_rgb(path), to_world) for name, path in files.items() if path.is_file()}
    plain = len(materials) == 1 and not meta.get("has_material_maps") and all(k in materials[0] for k in ("roughness", "metallic"))
    constants = (float(materials[0]["roughness"]), float(materials[0]["metallic"])) if plain else None
    return SceneTruth(train, lights, constants, _points(folder / "surface_points.npz", to_world))


def load_truth(view: View, scene: SceneTruth, to_world: np.ndarray) -> Truth:
    """The picture of a view, and what stands beside its file. Raises InputError where a map has another size than the view."""
    alpha = np.ones(view.colour.shape[:2], np.float32) if view.alpha is None else view.alpha
    picture = np.maximum(view.colour, 0) * alpha[..., None]
    folder = view.path.parent
    if view.path.stem != "rgba" or not (folder / "depth.exr").is_file():
        return Truth(picture, alpha)
    rotation, size = _rotation_and_size(to_world)
    layers: dict[str, np.ndarray] = {"depth": read_exr(folder / "depth.exr")["Z"] * np.float32(size)}
    if (folder / "albedo.exr").is_file():
        layers["albedo"] = read_exr_rgb(folder / "albedo.exr")
    if (folder / "normal.exr").is_file():
        layers["normal"] = read_exr_rgb(folder / "normal.exr") @ rotation.T.astype(np.float32)
    if (folder / "material.exr").is_file():
        material = read_exr(folder / "material.exr")
        layers["roughness"], layers["metallic"] = material["R"], material["G"]
    elif scene.constants:
        layers["roughness"], layers["metallic"] = (np.full(alpha.shape, value, np.float32) for value in scene.constants)
    files = {name: folder / f"rgba_{name}.png" for name in scene.lights}
    relit = {name: _picture(path) for name, path in files.items() if path.is_file()}
    for name, layer in [*layers.items(), *relit.items()]:
        if layer.shape[:2] != alpha.shape:
            sizes = f"{layer.shape[1]}x{layer.shape[0]}, the view {alpha.shape[1]}x{alpha.shape[0]}"
            raise InputError(folder, f"its true {name} is {sizes}", "evaluate at the pictures' own size (data.resolution)")
    return Truth(picture, alpha, **layers, relit=relit)


def turned(light: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    """A lat-long map (H, W, 3) of a dataset's frame in the world that `to_world` leads to."""
    rotation, _ = _rotation_and_size(to_world)
    if np.allclose(rotation, np.eye(3), atol=1e-7):
        return light
    direction = texel_directions(light.shape[0], light.shape[1], torch.float64).reshape(-1, 3) @ torch.from_numpy(rotation)
    return lookup(torch.from_numpy(light), direction.float()).reshape(light.shape).numpy()


def _picture(path: Path) -> np.ndarray:
    picture = read_picture(path)
    return unit(picture.colour) if picture.alpha is None else unit(picture.colour) * unit(picture.alpha)[..., None]


def _points(path: Path, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    if not path.is_file():
        return None
    with np.load(path) as data:
        points, normals = data["points"].astype(np.float64), data["normals"].astype(np.float64)
    return points @ to_world[:3, :3].T + to_world[:3, 3], normals @ _rotation_and_size(to_world)[0].T


def _rotation_and_size(similarity: np.ndarray) -> tuple[np.ndarray, float]:
    size = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    return similarity[:3, :3] / size, size
