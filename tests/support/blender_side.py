# SPDX-License-Identifier: GPL-3.0-or-later
"""Helpers of tests in Blender's process: the engine's libraries are not imported here, its work is done by its own Python.

$IRGSPP_PYTHON names that Python, as for the extension; without it this process's Python is used.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path

import numpy as np
import warm_engine

RESOURCES = None  # folder of Blender's user files for this process alone, if none is set; conftest.py removes it
if "BLENDER_USER_RESOURCES" not in os.environ:
    RESOURCES = tempfile.TemporaryDirectory(prefix="irgspp-blender-", ignore_cleanup_errors=True)
    os.environ["BLENDER_USER_RESOURCES"] = RESOURCES.name  # before bpy is imported

# Imported first, because it makes Blender's other modules importable. It gets no name here: pytest keeps the modules of fixtures until
# the process ends, and Blender 4.2 crashes if its module has not been released before.
import_module("bpy")

ROOT = Path(__file__).resolve().parents[2]
ENGINE = os.environ.get("IRGSPP_PYTHON") or sys.executable


def warm() -> str:
    """Return a stand-in of the engine's Python whose processes have the libraries loaded already."""
    return warm_engine.engine(ENGINE)


START = """
import runpy, sys
from pathlib import Path
root, script = Path(sys.argv[1]), sys.argv[2]
runpy.run_path(str(root / "irgspp_addon" / "launch.py"))["mount"](root)
sys.argv, sys.path[0] = sys.argv[2:], str(Path(script).parent)
runpy.run_path(script, run_name="__main__")
"""


def in_engine(script: Path, *arguments: object) -> str:
    """Run a script with the package `irgspp` in the engine's Python, and return its output."""
    command = [warm(), "-c", START, str(ROOT), str(script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def write_sphere_run(folder: Path, texture_size: int = 128, confidence: bool = False, tiles: int = 1) -> Path:
    """Write the run of `sphere_run` into a folder, and its photographs next to it."""
    in_engine(Path(__file__).with_name("sphere_run.py"), folder, texture_size, int(confidence), tiles)
    return folder


def read_image(path: Path, channels: int = 3) -> np.ndarray:
    """Read an EXR file by Blender's own reader: (H, W, channels) float32 without colour conversion, top row first."""
    import bpy

    image = bpy.data.images.load(str(path))
    try:
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        pixels = np.empty(height * width * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(height, width, -1)[::-1, :, :channels].copy()
    finally:
        bpy.data.images.remove(image)


def write_image(path: Path, pixels: np.ndarray) -> Path:
    """Write (H, W, 3) linear values, top row first, as a 32-bit EXR by Blender's own writer."""
    import bpy

    height, width = pixels.shape[:2]
    image = bpy.data.images.new(path.stem, width, height, float_buffer=True)
    try:
        image.colorspace_settings.name = "Non-Color"
        rgba = np.ones((height, width, 4), np.float32)
        rgba[..., :3] = pixels[::-1]
        image.pixels.foreach_set(rgba.reshape(-1))
        image.file_format, image.filepath_raw = "OPEN_EXR", str(path)
        image.save()
    finally:
        bpy.data.images.remove(image)
    return path
