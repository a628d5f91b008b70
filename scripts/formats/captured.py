# SPDX-License-Identifier: GPL-3.0-or-later
"""Folder of `irgspp capture`: a COLMAP model in the world's frame, masks, exposure gains and the object's bound."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from irgspp.core.datasets.formats.captured import EXPOSURES, FILE, FORMAT

from .colmap_files import write_model
from .source import Source, save_json, save_png

RADIUS = 1.3  # of the bound that the file states


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write the scene into the folder.

    Args:
        source: scene to write.
        folder: folder to fill.

    Returns:
        The folder, and the similarity (4, 4) from the scene's world to the dataset's frame: none.
    """
    shots = {f"{i:05d}.png": shot for i, shot in enumerate(source.interleaved())}
    for name, shot in shots.items():
        save_png(folder / "images" / name, shot.rgba[..., :3])
        save_png(folder / "masks" / name, shot.rgba[..., 3])
    width, height = source.size
    lens = [source.focal, source.focal, width / 2, height / 2]
    write_model(folder / "sparse" / "0", "PINHOLE", source.size, lens, {name: shot.pose for name, shot in shots.items()}, source.points)
    gains = {name.removesuffix(".png"): [1.0, 1.0, 1.0] for name in shots}
    bound = {"centre": [0.0, 0.0, 0.0], "radius": RADIUS}
    save_json(folder / FILE, {"format": FORMAT, "status": "done", "bound": bound})
    save_json(folder / EXPOSURES, gains)
    return folder, np.eye(4)
