# SPDX-License-Identifier: GPL-3.0-or-later
"""TensoIR synthetic: one folder for each view, linear 8-bit albedo, light maps next to the scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .source import Shot, Source, save_hdr, save_json, save_png

RELIGHTS = ("bridge", "city", "fireplace", "forest", "night")


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/NAME and folder/Environment_Maps.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the identity (4, 4): the dataset has the scene's frame.
    """
    scene = folder / source.name
    for split, shots in (("train", source.train), ("test", source.test), ("val", source.test[:1])):
        for i, shot in enumerate(shots):
            _view(source, shot, scene / f"{split}_{i:03d}", split == "test")
    for light, name in zip(source.lights, ("sunset", *RELIGHTS), strict=False):
        save_hdr(folder / "Environment_Maps" / "high_res_envmaps_1k" / f"{name}.hdr", source.lights[light])
    return scene, np.eye(4)


def _view(source: Source, shot: Shot, view: Path, complete: bool) -> None:
    """Write a view; `complete` ones have layers and relit images."""
    matrix = ",".join(repr(float(v)) for v in shot.pose.reshape(-1))
    meta = {"cam_angle_x": source.angle, "cam_transform_mat": matrix, "imw": source.size[0], "imh": source.size[1], "scene": "", "spp": 1}
    save_json(view / "metadata.json", meta)
    save_png(view / "rgba.png", shot.rgba)
    if not complete:
        return
    alpha = shot.alpha[..., None]
    save_png(view / "albedo.png", np.concatenate([shot.layers["albedo"], alpha], -1))
    save_png(view / "normal.png", np.concatenate([0.5 + 0.5 * shot.layers["normal"], alpha], -1))
    for light, name in zip(source.relights, RELIGHTS, strict=False):
        save_png(view / f"rgba_{name}.png", shot.relit[light])
