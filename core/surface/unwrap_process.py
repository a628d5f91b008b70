# SPDX-License-Identifier: GPL-3.0-or-later
"""UV unwrapping in a child process, beside other phases: xatlas works on one core for seconds, and holds Python's lock meanwhile."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import Cancelled, IrgsppError
from ..io.npz import read_arrays
from ..machine.blender_process import LAUNCHER
from ..machine.parent_watch import PARENT_WATCH
from ..scene.surface import Surface
from .meshing import Triangles
from .unwrap import unwrap

MESH, ATLAS = "mesh.npz", "atlas.npz"  # input and output of the child
NICE = 10  # the child works in the time that the kernels of other phases leave idle


class UnwrapProcess:
    """Child process that unwraps a mesh; close it to end it early.

    Args:
        mesh: mesh to unwrap.
        texture: texels along a side, of all tiles together.
        folder: folder of the files of this process and the child, created here and removed by `close`.
        tiles: UDIM tiles along a side.
    """

    def __init__(self, mesh: Triangles | Surface, texture: int, folder: Path, tiles: int = 1) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)  # a killed job may have left it
        np.savez(folder / MESH, vertices=mesh.vertices, faces=mesh.faces)
        self._errors = (folder / "errors.txt").open("w+", encoding="utf-8", errors="replace")
        command = [sys.executable, str(LAUNCHER), "core.surface.unwrap_process", str(folder), str(texture), str(tiles)]
        # Its stdin ends with this process, however this ends.
        self._child = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._errors, env={**os.environ, PARENT_WATCH: "1"}
        )

    def result(self, cancelled: Callable[[], bool]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Wait for the child and return what `unwrap` returns.

        Args:
            cancelled: asked five times a second.

        Raises:
            Cancelled: `cancelled` returned True.
            IrgsppError: the child failed.
        """
        status = None
        while status is None:
            try:
                status = self._child.wait(timeout=0.2)
            except subprocess.TimeoutExpired:
                if cancelled():
                    raise Cancelled("stopped during UV unwrapping") from None
        if status:
            self._errors.seek(0)
            lines = [line.strip() for line in self._errors if line.strip()] or ["no message"]
            raise IrgsppError(f"UV unwrapping ended with status {status}: {lines[-1]}")
        # Copied: they are read-only, and numba compiles kernels anew for such arrays.
        source, faces, uvs = (array.copy() for array in read_arrays(self._folder / ATLAS, "source", "faces", "uvs"))
        return source, faces, uvs

    def close(self) -> None:
        """End the child where it still works, and remove its files."""
        assert self._child.stdin is not None
        self._child.kill()
        self._child.wait()
        self._child.stdin.close()
        self._errors.close()
        shutil.rmtree(self._folder, ignore_errors=True)


def main(folder: Path, texture: int, tiles: int) -> None:
    """Unwrap the mesh in a folder and write the result there.

    Args:
        folder: holds the mesh's vertices and faces.
        texture: texels along a side, of all tiles together.
        tiles: UDIM tiles along a side.
    """
    if hasattr(os, "nice"):
        os.nice(NICE)
    vertices, faces = read_arrays(folder / MESH, "vertices", "faces")
    source, faces, uvs = unwrap(Triangles(vertices, faces), texture, tiles)
    np.savez(folder / ATLAS, source=source, faces=faces, uvs=uvs)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
