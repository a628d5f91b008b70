# SPDX-License-Identifier: GPL-3.0-or-later
"""Views of a run as image files: the recovered light or a new one, and the layers."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from ..datasets.load import load_dataset_cameras
from ..errors import Cancelled, InputError
from ..io.exr import rgb_channels, write_exr
from ..io.srgb import encode_srgb
from ..progress.protocol import Progress, Silent
from ..rendering.gbuffer import render_gbuffer
from ..run_folder import write_atomic
from ..scene.camera import Camera
from ..scene.environment_files import read_environment
from ..scene.gbuffer import NOTHING, GBuffer
from ..settings.schema import DataSettings
from ..shading.environment_lookup import rotate
from .prepared_light import prepare
from .relighter import Relighter

LAYERS = ("rgba", "albedo", "normal", "depth", "material", "radiance")


@dataclass(frozen=True, eq=False)
class Light:
    """A light to show the object under: its name in file names ("" is the recovered one) and an (H, W, 3) float32 linear lat-long map."""

    name: str
    image: np.ndarray


def load_light(
    path: Path, name: str | None = None, rotation: float = 0.0, strength: float = 1.0, progress: Progress | None = None
) -> Light:
    """Read a lat-long map, turned by `rotation` degrees about +Z (counter-clockwise from above), times `strength` (>= 0).

    Texels that are no light are repaired, which `progress` is told. Raises InputError where the file can't be read.
    """
    if not (strength >= 0 and np.isfinite(strength) and np.isfinite(rotation)):
        raise InputError("--strength, --rotation", f"{strength}, {rotation}: not a finite strength >= 0 and a finite angle")
    image, remarks = read_environment(path)
    for remark in remarks:
        (progress or Silent()).message(f"warning: {remark}")
    return Light(name or path.stem, (rotate(image, rotation) * strength).astype(np.float32))


def render_views(
    relighter: Relighter,
    cameras: Sequence[tuple[str, Camera]],
    out: Path,
    progress: Progress,
    *,
    layers: Sequence[str] = LAYERS,
    lights: Sequence[Light] = (),
) -> None:
    """Write `out/<view>/` for every named camera, each as soon as it is done: `rgba` under every light, and the other layers.

    Files: rgba.exr under the recovered light (no `lights`), else rgba_<light>.exr, linear premultiplied RGBA, and the same as 8-bit
    straight-alpha .png; radiance.exr like it, the Gaussians' own radiance; albedo.exr linear RGB; normal.exr unit world XYZ as RGB;
    depth.exr Z, planar; material.exr R roughness, G metallic. Raises InputError for an unknown layer, for lights of one name or where
    a folder can't be made, Cancelled between two images.
    """
    if unknown := set(layers) - set(LAYERS):
        raise InputError(f"layer {', '.join(sorted(unknown))}", "there is none of that name", f"use {', '.join(LAYERS)}")
    shown = lights or [Light("", relighter.reconstruction.environment_map())]
    if len({light.name for light in shown}) < len(shown):
        raise InputError("--environment", "two lights have the same name", "tell them apart by --name")
    prepared = [(light.name, prepare(light.image, relighter.device)) for light in shown] if "rgba" in layers else []
    progress.phase("render", len(cameras))
    for i, (name, camera) in enumerate(cameras):
        folder = out / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(folder, f"can't be made ({error.strerror})") from error
        if prepared:
            surface = relighter.surface(camera)
            for light_name, light in prepared:
                _stop_if_asked(progress, i, len(cameras))
                write_rgba(folder / (f"rgba_{light_name}" if light_name else "rgba"), relighter.relit(surface, light).numpy())
        if set(layers) - {"rgba"}:
            write_layers(folder, render_gbuffer(relighter.reconstruction, camera), layers)
        progress.step(i + 1)
        _stop_if_asked(progress, i + 1, len(cameras))


def _stop_if_asked(progress: Progress, done: int, views: int) -> None:
    if progress.cancelled:
        raise Cancelled(f"stopped after {done} of {views} views")


def write_rgba(stem: Path, rgba: np.ndarray) -> None:
    """(H, W, 4) linear premultiplied as `stem`.exr and, sRGB-encoded with straight alpha, as `stem`.png."""
    write_exr(stem.with_name(stem.name + ".exr"), rgb_channels(rgba))
    alpha = np.clip(rgba[..., 3:], 0, 1)
    straight = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 1e-6)
    encoded = np.concatenate([np.clip(encode_srgb(straight), 0, 1), alpha], -1)
    data = io.BytesIO()
    Image.fromarray(np.round(encoded * 255).astype(np.uint8)).save(data, "PNG")
    write_atomic(stem.with_name(stem.name + ".png"), data.getvalue())


def write_layers(folder: Path, buffers: GBuffer, layers: Sequence[str]) -> None:
    """Write those of albedo, normal, depth, material and radiance that are named in `layers`."""
    there = buffers.alpha > NOTHING
    colour = np.where(there[..., None], buffers.albedo, 0)
    channels = {
        "albedo": rgb_channels(colour),
        "normal": rgb_channels(np.where(there[..., None], buffers.normal, 0)),
        "depth": {"Z": np.where(there, buffers.depth, 0)},
        "material": {"R": np.where(there, buffers.roughness, 0), "G": np.where(there, buffers.metallic, 0)},
        "radiance": rgb_channels(buffers.image),
    }
    for name, data in channels.items():
        if name in layers:
            write_exr(folder / f"{name}.exr", data)


def cameras_of(text: str, settings: DataSettings, run_to_world: np.ndarray) -> list[tuple[str, Camera]]:
    """View names and cameras of `DATASET[:split]` in the world of a run, whose (4, 4) similarity from the dataset's frame is given.

    Raises InputError where the cameras can't be read or the split has none.
    """
    path, split = split_of(text)
    cameras, to_world = load_dataset_cameras(path, split, settings)
    move = run_to_world @ np.linalg.inv(to_world)  # read on its own, a dataset may be placed otherwise
    return [(name, camera.moved(move)) for name, camera in cameras]


def split_of(text: str) -> tuple[Path, str | None]:
    """`DATASET[:split]` in its parts; a drive letter's colon is no split. Raises InputError for a split that is none."""
    path, colon, split = text.rpartition(":")
    if not colon or Path(text).exists() or "/" in split or "\\" in split:
        return Path(text), None
    if split not in ("train", "test", "all"):
        raise InputError(text, "no such split", "use DATASET:train, DATASET:test or DATASET:all")
    return Path(path), split
