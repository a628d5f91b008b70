# SPDX-License-Identifier: GPL-3.0-or-later
"""Light maps under the names that published datasets use: this program's own lights, turned and tinted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from irgspp.core.io.exr import rgb_channels, write_exr
from irgspp.core.shading.procedural_lights import LIGHTS

Recipe = tuple[str, float, tuple[float, float, float]]  # light, turn in degrees, factor per channel

RECIPES: dict[str, Recipe] = {
    "sunset": ("sunset", 0, (1, 1, 1)),
    "bridge": ("sky", 0, (1, 1, 1)),
    "city": ("studio", 60, (0.9, 1, 1.15)),
    "fireplace": ("sunset", 150, (1.2, 0.8, 0.6)),
    "forest": ("sky", -110, (0.8, 1.1, 0.7)),
    "night": ("studio", -140, (0.4, 0.5, 0.8)),
    "corridor": ("studio", 100, (1, 0.95, 0.85)),
    "golf": ("sky", 80, (0.95, 1.05, 0.9)),
    "neon": ("studio", -60, (1.2, 0.7, 1.2)),
    "outdoors": ("sky", -50, (1, 1, 1)),
    "indoors": ("studio", 0, (1, 1, 1)),
}


def write_light(name: str, folder: Path, height: int) -> Path:
    """Write a light map as an EXR file and return its path.

    Args:
        name: one of RECIPES.
        folder: folder of the file.
        height: rows of the map.
    """
    light, turn, tint = RECIPES[name]
    pixels = LIGHTS[light](height, 2 * height) * np.array(tint)
    file = folder / f"{name}.exr"
    folder.mkdir(parents=True, exist_ok=True)
    write_exr(file, rgb_channels(np.roll(pixels, -round(turn / 360 * 2 * height), 1).astype(np.float32)))
    return file
