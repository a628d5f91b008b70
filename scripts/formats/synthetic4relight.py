# SPDX-License-Identifier: GPL-3.0-or-later
"""Synthetic4Relight: EXR photographs with masks, encoded albedo, relit images in a folder of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from irgspp.core.io.srgb import encode_srgb

from .source import Shot, Source, save_exr, save_json, save_png

BACKDROP = 0.3  # linear grey of the photographs' background
LIGHTS = ("envmap3", "envmap6", "envmap12")


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/NAME and folder/envmaps.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the identity (4, 4): the dataset has the scene's frame.
    """
    scene = folder / source.name
    for split, shots in (("train", source.train), ("test", source.test)):
        frames = [{"file_path": f"{split}/{i:03d}", "transform_matrix": s.pose.tolist()} for i, s in enumerate(shots)]
        save_json(scene / f"transforms_{split}.json", {"camera_angle_x": source.angle, "frames": frames})
    for i, shot in enumerate(source.train):
        radiance = shot.radiance()
        save_exr(scene / "train" / f"{i:03d}_rgb.exr", radiance[..., :3] + BACKDROP * (1 - radiance[..., 3:]))
        save_png(scene / "train" / f"{i:03d}_mask.png", (255 * (shot.alpha > 0.5)).astype(np.uint8))
    for i, shot in enumerate(source.test):
        _test(source, shot, scene, f"{i:03d}")
    for light, name in zip(source.lights, LIGHTS, strict=False):
        save_exr(folder / "envmaps" / f"{name}.exr", source.lights[light])
    return scene, np.eye(4)


def _test(source: Source, shot: Shot, scene: Path, name: str) -> None:
    """Write a test view: image, albedo, roughness and relit images."""
    alpha = shot.alpha[..., None]
    save_png(scene / "test" / f"{name}_rgba.png", shot.rgba)
    save_png(scene / "test" / f"{name}_albedo.png", np.concatenate([encode_srgb(shot.layers["albedo"]), alpha], -1))
    if "material" in shot.layers:
        save_png(scene / "test" / f"{name}_rough.png", shot.layers["material"][..., 0])
    for light, label in zip(source.relights, LIGHTS[1:], strict=False):
        save_png(scene / "test_rli" / f"{label}_{name}.png", shot.relit[light])
