# SPDX-License-Identifier: GPL-3.0-or-later
"""Environment map of any World: plain Worlds are read, others are rendered by a second Blender in the background."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bpy
import numpy as np

from ...core.errors import InputError, IrgsppError
from ...core.scene.environment_map import EnvironmentMap
from ..engine.child import detached
from ..engine.managed import LAUNCHER
from .fingerprint import fingerprint
from .plain_world import forget_images, plain_light

ROWS = 1024  # height of a rendered World in pixels; the sun of a Sky Texture is half a degree wide
PATIENCE = 120.0  # seconds that rendering a World may take
CHILD = "irgspp_addon.world.bake_child"  # module that the other Blender runs

_rendered: dict[str, EnvironmentMap] = {}  # by the key of `_key`, the latest few


def world_light(world: bpy.types.World | None, frame: int = 1, timeout: float = PATIENCE) -> EnvironmentMap:
    """Return the environment map of a World, waiting for its rendering if needed; it also works while Blender renders.

    Args:
        world: the World.
        frame: frame of the animation.
        timeout: maximum time to wait in seconds.

    Raises:
        InputError: if there is no World or its image is missing.
        IrgsppError: if it can't be rendered in time.
    """
    result = ask_world(world, frame)
    if isinstance(result, EnvironmentMap):
        return result
    try:
        return result.wait(timeout)
    finally:
        result.close()


def ask_world(world: bpy.types.World | None, frame: int = 1) -> EnvironmentMap | WorldBake:
    """Return the environment map of a World if it can be read or is known, otherwise start to render it.

    Args:
        world: the World.
        frame: frame of the animation.

    Raises:
        InputError: if there is no World or its image is missing.
        IrgsppError: if the rendering can't be started.
    """
    light = plain_light(world)
    if light is not None:
        return light
    assert world is not None
    return _rendered.get(_key(world, frame)) or WorldBake(world, frame)


def _key(world: bpy.types.World, frame: int) -> str:
    """Return the cache key of a World: its fingerprint, and the frame if it may be animated."""
    animated = world.animation_data is not None or (world.node_tree is not None and world.node_tree.animation_data is not None)
    return f"{fingerprint(world)} {frame if animated else ''}"


class WorldBake:
    """Rendering of a World by another Blender: call `poll` until it returns the light, and `close` in any case.

    Args:
        world: the World.
        frame: frame of the animation.
        rows: height of the environment map in pixels.
    """

    def __init__(self, world: bpy.types.World, frame: int = 1, rows: int = ROWS) -> None:
        self._key, self._name = _key(world, frame), world.name
        self._folder = Path(tempfile.mkdtemp(prefix="irgspp-world-"))
        self._map, self._log = self._folder / "map.npy", self._folder / "log.txt"
        try:
            self._child = self._start(world, rows, frame)
        except (OSError, RuntimeError) as error:  # the latter is Blender's
            shutil.rmtree(self._folder, ignore_errors=True)
            raise IrgsppError(f"World {world.name}: could not be rendered ({str(error).strip()})") from error

    def _start(self, world: bpy.types.World, rows: int, frame: int) -> subprocess.Popen:
        blend = self._folder / "world.blend"
        bpy.data.libraries.write(str(blend), {world.original}, path_remap="ABSOLUTE", fake_user=True)
        command = [*blender_command(), CHILD, str(blend), str(self._map), str(rows), str(frame)]
        with self._log.open("wb") as log:
            return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, **detached())

    def shows(self, world: bpy.types.World | None, frame: int) -> bool:
        """Return True if this renders the World in its current state.

        Args:
            world: the World.
            frame: frame of the animation.
        """
        return world is not None and self._key == _key(world, frame)

    def poll(self) -> EnvironmentMap | None:
        """Return the environment map if it is finished, else None; raise IrgsppError if the rendering failed."""
        status = self._child.poll()
        if status is None:
            return None
        if status or not self._map.is_file():
            lines = self._log.read_text(errors="replace").strip().splitlines()
            raise IrgsppError(f"World {self._name}: could not be rendered ({lines[-1] if lines else f'status {status}'})")
        light = EnvironmentMap(np.load(self._map, allow_pickle=False))
        while len(_rendered) >= 4:
            del _rendered[next(iter(_rendered))]
        _rendered[self._key] = light
        return light

    def wait(self, timeout: float) -> EnvironmentMap:
        """Wait for the environment map; raise IrgsppError if the rendering fails or takes longer than `timeout` seconds."""
        until = time.monotonic() + timeout
        while time.monotonic() < until:
            if (light := self.poll()) is not None:
                return light
            time.sleep(0.02)
        raise IrgsppError(f"World {self._name}: not rendered within {timeout:.0f} seconds")

    def close(self) -> None:
        """End the other Blender if it still runs, and delete its files."""
        if self._child.poll() is None:
            self._child.kill()
        self._child.wait()
        shutil.rmtree(self._folder, ignore_errors=True)


def forget() -> None:
    """Clear all cached environment maps: another .blend may have other images under the same names."""
    _rendered.clear()
    forget_images()


def blender_command() -> list[str]:
    """Return the command line that runs a module of the extension in another Blender of this version, up to the module's name."""
    if bpy.app.binary_path:
        return [bpy.app.binary_path, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(LAUNCHER), "--"]
    return [sys.executable, str(LAUNCHER)]  # Blender as a module


def save_light(light: EnvironmentMap, path: Path, rows: int) -> None:
    """Write an environment map as 32-bit .exr or as .npy, atomically.

    Args:
        light: environment map.
        path: file to write, with suffix .exr or .npy.
        rows: height of the written map in pixels; its width is twice that.

    Raises:
        InputError: if the suffix is another one, or the file can't be written.
    """
    save = {".npy": np.save, ".exr": _save_exr}.get(path.suffix.lower())
    if save is None:
        raise InputError(path, "is not a file name for a light map", "let the name end with .exr or .npy")
    partial = path.with_name(f".{path.stem}.part{path.suffix.lower()}")
    try:
        save(partial, light.image(rows))
        partial.replace(path)
    except (OSError, RuntimeError) as error:  # the latter is Blender's
        partial.unlink(missing_ok=True)
        raise InputError(path, f"can't be written ({getattr(error, 'strerror', None) or str(error).strip()})") from error


def _save_exr(path: Path, texels: np.ndarray) -> None:
    """Write texels (H, W, 3) as EXR by Blender's own functions, because other EXR libraries crash in its process."""
    rows, columns = texels.shape[:2]
    image = bpy.data.images.new("irgspp light map", columns, rows, float_buffer=True, is_data=True)
    try:
        rgba = np.concatenate([texels[::-1], np.ones((rows, columns, 1), np.float32)], -1)
        image.pixels.foreach_set(np.ascontiguousarray(rgba, np.float32).reshape(-1))
        image.file_format, image.filepath_raw = "OPEN_EXR", str(path)
        image.save()
    finally:
        bpy.data.images.remove(image)
