# SPDX-License-Identifier: GPL-3.0-or-later
"""Views of a run as image files, under the recovered light or new ones, with their G-buffer layers."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from ..datasets.load import load_dataset_cameras
from ..errors import Cancelled, InputError
from ..io.exr import rgb_channels, write_exr
from ..io.quantisation import eight_bits
from ..io.srgb import straight_srgb
from ..progress.protocol import Progress, Silent
from ..rendering.layers import LAYERS
from ..run_folder import write_atomic
from ..scene.camera import Camera
from ..scene.environment_files import read_environment
from ..scene.gbuffer import EMPTY_ALPHA, GBuffer
from ..scene.lamps import Lamp, read_lamps
from ..settings.schema import DataSettings
from ..shading.environment_lookup import rotate
from .prepared_light import prepare_light
from .relighter import Relighter


@dataclass(frozen=True, eq=False)
class Light:
    """Light to render under.

    Attributes:
        name: part of the file names; "" is the recovered light.
        image: (H, W, 3) float32 linear lat-long map.
    """

    name: str
    image: np.ndarray


def load_light(
    path: Path, name: str | None = None, rotation: float = 0.0, strength: float = 1.0, progress: Progress | None = None
) -> Light:
    """Read a lat-long map as a light.

    Args:
        path: .exr, .hdr, .png or .jpg file.
        name: name of the light; None is the file's name without its extension.
        rotation: degrees about +Z, counter-clockwise seen from above.
        strength: factor of the radiance, >= 0.
        progress: receives a warning for repaired texels (NaN, infinite, negative).

    Raises:
        InputError: when the file can't be read, or rotation or strength is not finite, or strength is negative.
    """
    if not (strength >= 0 and np.isfinite(strength) and np.isfinite(rotation)):
        raise InputError("--strength, --rotation", f"{strength}, {rotation}: the strength must be finite and >= 0, the angle finite")
    image, remarks = read_environment(path)
    for remark in remarks:
        (progress or Silent()).message(f"warning: {remark}")
    return Light(name or path.stem, (rotate(image, rotation) * strength).astype(np.float32))


def load_lamps(path: Path) -> tuple[Lamp, ...]:
    """Read lamps from a JSON file, in the run's frame.

    Args:
        path: file with a list of lamps, see `core/scene/lamps.py`.

    Raises:
        InputError: when the file can't be read or a lamp is invalid.
    """
    try:
        values = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(path, f"the lamps can't be read ({error})", "give a JSON list of lamps") from error
    return read_lamps(values)


def render_views(
    relighter: Relighter,
    cameras: Sequence[tuple[str, Camera]],
    out: Path,
    progress: Progress,
    *,
    layers: Sequence[str] = LAYERS,
    lights: Sequence[Light] = (),
    lamps: Sequence[Lamp] = (),
) -> None:
    """Write `out/<view>/` for every camera, each as soon as it is finished: `rgba` under every light, and the other layers.

    Files: rgba.exr under the recovered light (no `lights`), else rgba_<light>.exr, linear premultiplied RGBA, and the same as 8-bit
    straight-alpha .png; radiance.exr, the Gaussians' own radiance, likewise RGBA; albedo.exr linear RGB; normal.exr unit world XYZ as RGB;
    depth.exr Z, planar; material.exr R roughness, G metallic; confidence.exr of R albedo, G roughness, B metallic, where it is known.

    Args:
        relighter: relighter of the run.
        cameras: views' names and cameras.
        out: output folder.
        progress: reports each view, and may cancel between two images.
        layers: names out of LAYERS.
        lights: lights to render under; none is the recovered light.
        lamps: lamps that add to each of the lights.

    Raises:
        InputError: when a layer is unknown, two lights have the same name, or a folder can't be created.
        Cancelled: when `progress` is cancelled.
    """
    if unknown := set(layers) - set(LAYERS):
        raise InputError(f"layer {', '.join(sorted(unknown))}", "unknown name", f"use {', '.join(LAYERS)}")
    lights = lights or [Light("", relighter.reconstruction.environment_map())]
    if len({light.name for light in lights}) < len(lights):
        raise InputError("--environment", "two lights have the same name", "give each its own --name")
    prepared = [(light.name, prepare_light(light.image, relighter.device)) for light in lights] if "rgba" in layers else []
    if "confidence" in layers and relighter.reconstruction.confidence is None:
        progress.message("no confidence.exr: this run did not measure the confidence of its materials")
    progress.phase("render", len(cameras))
    for i, (name, camera) in enumerate(cameras):
        folder = out / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(folder, f"can't be created ({error.strerror})") from error
        surface = relighter.surface(camera) if prepared else None
        if surface is not None:
            for light_name, light in prepared:
                _raise_if_cancelled(progress, i, len(cameras))
                write_rgba(folder / (f"rgba_{light_name}" if light_name else "rgba"), relighter.relit(surface, light, lamps).numpy())
        if set(layers) - {"rgba"}:
            write_layers(folder, relighter.gbuffer(camera, surface), layers)
        progress.step(i + 1)
        _raise_if_cancelled(progress, i + 1, len(cameras))


def _raise_if_cancelled(progress: Progress, done: int, views: int) -> None:
    """Raise Cancelled when the user stopped the work."""
    if progress.cancelled:
        raise Cancelled(f"stopped after {done} of {views} views")


def write_rgba(stem: Path, rgba: np.ndarray) -> None:
    """Write an image as `stem`.exr and, sRGB-encoded with straight alpha, as `stem`.png.

    Args:
        stem: path without extension.
        rgba: (H, W, 4) linear premultiplied.
    """
    write_exr(stem.with_name(stem.name + ".exr"), rgb_channels(rgba))
    data = io.BytesIO()
    Image.fromarray(eight_bits(straight_srgb(rgba))).save(data, "PNG")
    write_atomic(stem.with_name(stem.name + ".png"), data.getvalue())


def write_layers(folder: Path, gbuffer: GBuffer, layers: Sequence[str]) -> None:
    """Write the layers of a view other than `rgba`; normals, depth and materials are 0 where nothing is visible.

    Args:
        folder: folder of the view.
        gbuffer: G-buffer of the view, (H, W).
        layers: names of the layers to write.
    """
    covered = gbuffer.alpha > EMPTY_ALPHA
    colour = np.where(covered[..., None], gbuffer.albedo, 0)
    channels = {
        "albedo": rgb_channels(colour),
        "normal": rgb_channels(np.where(covered[..., None], gbuffer.normal, 0)),
        "depth": {"Z": np.where(covered, gbuffer.depth, 0)},
        "material": {"R": np.where(covered, gbuffer.roughness, 0), "G": np.where(covered, gbuffer.metallic, 0)},
        "radiance": rgb_channels(gbuffer.image),
    }
    if gbuffer.confidence is not None:
        channels["confidence"] = rgb_channels(np.where(covered[..., None], gbuffer.confidence, 0))
    for name, data in channels.items():
        if name in layers:
            write_exr(folder / f"{name}.exr", data)


def cameras_of(path: Path, split: str | None, settings: DataSettings, run_to_world: np.ndarray) -> list[tuple[str, Camera]]:
    """Read the cameras of a dataset in the world frame of a run.

    Args:
        path: the dataset.
        split: see `load_dataset_cameras`.
        settings: data settings of the run.
        run_to_world: (4, 4) similarity from the dataset's own frame to the run's world.

    Returns:
        Names of the views and cameras.

    Raises:
        InputError: when the cameras can't be read or the split has none.
    """
    cameras, to_world = load_dataset_cameras(path, split, settings)
    move = run_to_world @ np.linalg.inv(to_world)  # a dataset read on its own may be normalised differently
    return [(name, camera.moved(move)) for name, camera in cameras]


def split_of(text: str) -> tuple[Path, str | None]:
    """Split `DATASET[:split]` into path and split; the colon of a drive letter is not a split.

    Raises:
        InputError: when the split is not train, test or all.
    """
    path, colon, split = text.rpartition(":")
    if not colon or Path(text).exists() or "/" in split or "\\" in split:
        return Path(text), None
    if split not in ("train", "test", "all"):
        raise InputError(text, f"unknown split {split}", "use DATASET:train, DATASET:test or DATASET:all")
    return Path(path), split
