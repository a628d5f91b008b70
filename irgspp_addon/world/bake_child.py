# SPDX-License-Identifier: GPL-3.0-or-later
"""Render the World of a .blend as an environment map, in a separate Blender that does not disturb the user's.

`launch.py irgspp_addon.world.bake_child WORLD.blend MAP.npy ROWS FRAME`
"""

import os
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

from .light_to_world import bake_world


def bake(blend: str, target: str, rows: int, frame: int) -> None:
    """Append the first World of a .blend, render it, and write the environment map, (rows, 2 rows, 3) float32.

    Args:
        blend: .blend file with the World.
        target: .npy file to write, atomically.
        rows: height of the environment map in pixels.
        frame: frame of the animation.
    """
    with bpy.data.libraries.load(blend) as (source, wanted):
        wanted.worlds = source.worlds[:1]
    world = bpy.context.scene.world = wanted.worlds[0]
    if hasattr(world, "cycles_visibility"):
        world.cycles_visibility.camera = True  # a World that is hidden from cameras still lights the object
    bpy.context.scene.frame_set(frame)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "world.exr"
        bake_world(bpy.context.scene, file, rows)
        image = bpy.data.images.load(str(file))
        pixels = np.empty(rows * 2 * rows * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
    texels = pixels.reshape(rows, 2 * rows, -1)[::-1, :, :3]
    texels = np.ascontiguousarray(np.maximum(np.nan_to_num(texels, nan=0.0, posinf=0.0), 0))  # light is finite and >= 0
    partial = target + ".part.npy"
    np.save(partial, texels)
    os.replace(partial, target)


if __name__ == "__main__":
    bake(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
