# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders the one World of a .blend as a light map: a Blender of its own, so that the artist's is not disturbed.

blender --background --factory-startup --python bake_child.py -- WORLD.blend MAP.npy ROWS FRAME    or    python bake_child.py -- ...
"""

import importlib.util
import os
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np


def _world_module():
    """`light_to_world.py` beside this file, which needs Blender alone."""
    spec = importlib.util.spec_from_file_location("irgspp_world", Path(__file__).with_name("light_to_world.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def bake(blend: str, target: str, rows: int, frame: int) -> None:
    """Append the World, render it, write (rows, 2 rows, 3) float32."""
    with bpy.data.libraries.load(blend) as (source, wanted):
        wanted.worlds = source.worlds[:1]
    world = bpy.context.scene.world = wanted.worlds[0]
    if hasattr(world, "cycles_visibility"):
        world.cycles_visibility.camera = True  # a light that the camera does not see is a light all the same
    bpy.context.scene.frame_set(frame)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "world.exr"
        _world_module().bake_world(bpy.context.scene, file, rows)
        image = bpy.data.images.load(str(file))
        pixels = np.empty(rows * 2 * rows * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
    texels = pixels.reshape(rows, 2 * rows, -1)[::-1, :, :3]
    texels = np.ascontiguousarray(np.maximum(np.nan_to_num(texels, nan=0.0, posinf=0.0), 0))  # light is finite and >= 0
    partial = target + ".part.npy"
    np.save(partial, texels)
    os.replace(partial, target)


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1 :]
    bake(given[0], given[1], int(given[2]), int(given[3]))
