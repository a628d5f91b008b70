# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene of known geometry, light and materials, rendered once by Cycles: a mirror-like ball next to a block, lit by coloured axes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import warm_engine
from irgspp.core.io.exr import rgb_channels, write_exr
from irgspp.core.shading.environment_lookup import texel_directions
from shared_folder import made_once

ROOT = Path(__file__).resolve().parents[2]
BALL, RADIUS = np.array([0.15, -0.08, 0.1]), 0.75
SIZE = 44
SCENE = """
import bpy, sys
x, y, z, radius = (float(v) for v in sys.argv[2:6])
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
def material(name, colour, roughness, metallic):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    inputs = made.node_tree.nodes['Principled BSDF'].inputs
    inputs['Base Color'].default_value = (*colour, 1)
    inputs['Roughness'].default_value, inputs['Metallic'].default_value = roughness, metallic
    bpy.context.object.data.materials.append(made)
bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=(x, y, z), segments=64, ring_count=32)
bpy.ops.object.shade_smooth()
material('ball', (0.9, 0.85, 0.8), 0.2, 1.0)
bpy.ops.mesh.primitive_cube_add(size=0.6, location=(-0.5, 0.35, -0.35), rotation=(0.2, 0.1, 0.6))
material('block', (0.6, 0.3, 0.15), 0.6, 0.0)
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""

# Linear colours at +X, -X, +Y, -Y, +Z, -Z, all different, so that every rotation by a quarter and every reflection is detected.
AXES = {
    "axes": [(0.9, 0.1, 0.1), (0.1, 0.7, 0.7), (0.15, 0.8, 0.1), (0.7, 0.1, 0.7), (0.6, 0.6, 0.9), (0.3, 0.25, 0.05)],
    "second": [(0.1, 0.2, 0.9), (0.9, 0.5, 0.1), (0.8, 0.8, 0.7), (0.5, 0.05, 0.1), (0.1, 0.6, 0.2), (0.3, 0.1, 0.5)],
    "third": [(0.7, 0.7, 0.1), (0.2, 0.1, 0.6), (0.1, 0.4, 0.5), (0.9, 0.3, 0.4), (0.4, 0.1, 0.1), (0.1, 0.7, 0.3)],
}


def axes_light(name: str, height: int = 64) -> np.ndarray:
    """Return an environment map (H, 2H, 3), linear, with a colour at each axis and smooth transitions."""
    direction = texel_directions(height, 2 * height).numpy()
    towards = np.stack([s * direction[..., i] for i in range(3) for s in (1, -1)], -1)
    weight = np.clip(towards, 0, None) ** 3
    return ((weight @ np.array(AXES[name])) / weight.sum(-1, keepdims=True)).astype(np.float32)


def render_scene(folder: Path) -> Path:
    """Return the scene as a dataset of scripts/render_dataset.py with 16 training and 3 test views; the first process renders it."""
    return made_once(folder, _render) / "scene"


def _render(folder: Path) -> None:
    for name in AXES:
        write_exr(folder / f"{name}.exr", rgb_channels(axes_light(name)))
    _run(folder, "-c", SCENE, folder / "scene.blend", *BALL, RADIUS)
    lights = ["--light", folder / "axes.exr", "--relight", folder / "second.exr", folder / "third.exr"]
    numbers = ["--resolution", SIZE, "--train", 16, "--test", 3, "--samples", 24, "--points", 400]
    _run(folder, ROOT / "scripts" / "render_dataset.py", folder / "scene.blend", "-o", folder / "scene", *lights, *numbers)


def _run(folder: Path, *arguments: object) -> None:
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(folder), "OMP_WAIT_POLICY": "PASSIVE"}
    command = [warm_engine.engine(sys.executable), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
