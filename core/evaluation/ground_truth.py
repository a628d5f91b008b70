# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground truth stored next to the images of a rendered dataset, brought into the world frame of a run."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..datasets.format_detection import parse_dataset
from ..datasets.ground_truth import MapFile, ground_truth_layers, light_files, relit_names
from ..errors import InputError
from ..io.exr import read_exr, read_exr_rgb
from ..io.safe_paths import inside
from ..scene.dataset import View
from ..scene.environment_files import read_environment
from ..settings.schema import DataSettings
from ..shading.environment_lookup import turned
from .reduction import fitted_image, fitted_layer
from .surface_truth import rendered_points, surface_points


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of one view; what is not known is None or missing.

    Attributes:
        image: (H, W, 3) encoded, times alpha, above 1 where the file is HDR.
        alpha: (H, W), ones where the dataset has none.
        albedo: (H, W, 3) linear.
        normal: (H, W, 3) unit, in the world frame of the run.
        depth: (H, W) planar, in the run's units, 0 where no surface is.
        roughness: (H, W).
        metallic: (H, W).
        relit: light name -> (H, W, 3) encoded, times that image's alpha, above 1 where the file is HDR. Of a view that was taken under
            another light than the dataset's (`View.light`), the image itself.
        lights: light name -> (H', W', 3) linear lat-long map in the world frame of the run, where the light is known view by view; it
            takes precedence over the scene's of the same name. No image is relit under lights that neither of the two has.
    """

    image: np.ndarray
    alpha: np.ndarray
    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    roughness: np.ndarray | None = None
    metallic: np.ndarray | None = None
    relit: dict[str, np.ndarray] = field(default_factory=dict)
    lights: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def object(self) -> np.ndarray:
        """(H, W) bool: pixels that are inside the object for certain."""
        inside = self.alpha > 0.99
        return inside if self.depth is None else inside & (self.depth > 0)


@dataclass(frozen=True, eq=False)
class SceneTruth:
    """Ground truth of the whole scene.

    Attributes:
        train_light: name of the light of the training views.
        lights: name -> (H, W, 3) linear lat-long map in the world frame of the run.
        constants: roughness and metallic of a scene of a single uniform material.
        points: samples of the surface, positions (N, 3) and unit normals (N, 3).
        format: of the dataset, which decides where the ground truth of a view is found.
    """

    train_light: str | None = None
    lights: dict[str, np.ndarray] = field(default_factory=dict)
    constants: tuple[float, float] | None = None
    points: tuple[np.ndarray, np.ndarray] | None = None
    format: str = "transforms"


def load_scene_truth(dataset: Path, to_world: np.ndarray) -> SceneTruth:
    """Read the ground truth of a dataset's scene, as far as the files exist; lights without relit images are left out.

    Args:
        dataset: folder or file.
        to_world: (4, 4) similarity from the dataset's frame to the run's world frame.

    Raises:
        InputError: when a file is damaged.
    """
    folder = dataset if dataset.is_dir() else dataset.parent
    if (folder / "meta.json").is_file():
        return _rendered_scene(folder, to_world)
    try:
        capture = parse_dataset(dataset, DataSettings())
    except InputError:
        return SceneTruth()  # reading its views reports the error
    relit = sorted({name for frame in (capture.test or [])[:1] if frame.image for name in relit_names(capture.format, frame.image)})
    train, files = light_files(capture.format, folder, relit)
    lights = {name: _light(file, to_world) for name, file in files.items()}
    return SceneTruth(train, lights, None, _moved_points(surface_points(capture.format, folder), to_world), capture.format)


def _rendered_scene(folder: Path, to_world: np.ndarray) -> SceneTruth:
    """Read meta.json, envs/ and surface_points.npz of a dataset that scripts/render_dataset.py wrote."""
    file = folder / "meta.json"
    try:
        meta = json.loads(file.read_text(encoding="utf-8"))
        train, relights = meta.get("train_light"), list(meta.get("relights", []))
        materials = [m for m in dict(meta.get("materials", {})).values() if isinstance(m, dict)]
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(file, f"is not the description of a rendered dataset ({error})", "render the dataset again") from error
    files = {name: inside(folder / "envs" / f"{name}.exr", folder) for name in [train, *relights] if name}
    lights = {name: rotate_to_frame(read_exr_rgb(path), to_world) for name, path in files.items() if path.is_file()}
    plain = len(materials) == 1 and not meta.get("has_material_maps") and all(k in materials[0] for k in ("roughness", "metallic"))
    constants = (float(materials[0]["roughness"]), float(materials[0]["metallic"])) if plain else None
    return SceneTruth(train, lights, constants, _moved_points(rendered_points(folder), to_world))


def load_truth(view: View, scene: SceneTruth, to_world: np.ndarray) -> Truth:
    """Read the ground truth of a view and resize it to the view's size.

    Args:
        view: whose image is taken, and next to whose file the ground truth is looked for.
        scene: ground truth of the scene.
        to_world: (4, 4) similarity from the dataset's frame to the run's world frame.

    Raises:
        InputError: when a file is damaged, or the view's size is not that of the file reduced.
    """
    alpha = np.ones(view.colour.shape[:2], np.float32) if view.alpha is None else view.alpha
    image = np.maximum(view.colour, 0) * alpha[..., None]
    rotation, size = _rotation_and_size(to_world)
    stated = ground_truth_layers(scene.format, view)
    layers = {"albedo": stated.albedo, "normal": stated.normal, "depth": stated.depth, "roughness": stated.roughness}
    relit_files = stated.relit
    if scene.format == "transforms":
        layers, relit_files = _rendered_layers(view, scene)
    shape = alpha.shape[0], alpha.shape[1]
    fitted = {name: fitted_layer(view.path.parent, name, layer, shape, stated.cover) for name, layer in layers.items() if layer is not None}
    if "normal" in fitted:
        fitted["normal"] = fitted["normal"] @ rotation.T.astype(np.float32)
    if "depth" in fitted:
        fitted["depth"] = fitted["depth"] * np.float32(size)
    relit = {name: fitted_image(path, shape, alpha) for name, path in relit_files.items()}
    if view.light is not None:
        relit[view.light] = image
    lights = {name: _light(file, to_world) for name, file in stated.lights.items()}
    return Truth(image, alpha, **fitted, relit=relit, lights=lights)


def _rendered_layers(view: View, scene: SceneTruth) -> tuple[dict[str, np.ndarray | None], dict[str, Path]]:
    """Read the layers and list the relit images next to a test image that scripts/render_dataset.py wrote."""
    folder = view.path.parent
    if view.path.stem != "rgba" or not (folder / "depth.exr").is_file():
        return {}, {}
    for name in ("depth", "albedo", "normal", "material", *scene.lights):
        inside(folder / (f"rgba_{name}.png" if name in scene.lights else f"{name}.exr"), folder)
    layers: dict[str, np.ndarray | None] = {"depth": read_exr(folder / "depth.exr")["Z"]}
    if (folder / "albedo.exr").is_file():
        layers["albedo"] = read_exr_rgb(folder / "albedo.exr")
    if (folder / "normal.exr").is_file():
        layers["normal"] = read_exr_rgb(folder / "normal.exr")
    if (folder / "material.exr").is_file():
        material = read_exr(folder / "material.exr")
        layers["roughness"], layers["metallic"] = material["R"], material["G"]
    elif scene.constants:
        shape = view.colour.shape[:2]
        layers["roughness"], layers["metallic"] = (np.full(shape, value, np.float32) for value in scene.constants)
    files = {name: folder / f"rgba_{name}.png" for name in scene.lights}
    return layers, {name: path for name, path in files.items() if path.is_file()}


def _light(file: MapFile, to_world: np.ndarray) -> np.ndarray:
    """Read a light map (H, W, 3) and turn it into the world frame of the run."""
    light, _ = read_environment(file.path)
    whole = np.eye(4)
    whole[:3, :3] = to_world[:3, :3] @ file.turn
    return rotate_to_frame(light, whole)


def rotate_to_frame(light: np.ndarray, to_world: np.ndarray) -> np.ndarray:
    """Rotate a lat-long map into another frame.

    Args:
        light: (H, W, 3), in the dataset's frame.
        to_world: (4, 4) similarity to the other frame.

    Returns:
        (H, W, 3), in the other frame.
    """
    rotation, _ = _rotation_and_size(to_world)
    return turned(light, rotation.T)


def _moved_points(points: tuple[np.ndarray, np.ndarray] | None, to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Transform positions (N, 3) and normals (N, 3) by the similarity `to_world` (4, 4)."""
    if points is None:
        return None
    position, normal = (a.astype(np.float64) for a in points)
    return position @ to_world[:3, :3].T + to_world[:3, 3], normal @ _rotation_and_size(to_world)[0].T


def _rotation_and_size(similarity: np.ndarray) -> tuple[np.ndarray, float]:
    """Split a similarity (4, 4) into its rotation (3, 3) and its scale."""
    size = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    return similarity[:3, :3] / size, size
