# SPDX-License-Identifier: GPL-3.0-or-later
"""UV unwrapping in the process of a job, for tests of other parts of jobs: the child that it has in a job takes a second to start."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from irgspp.core import pipeline
from irgspp.core.scene.surface import Surface
from irgspp.core.surface.meshing import Triangles
from irgspp.core.surface.unwrap import unwrap


class _Unwrapping:
    """Stand-in of `UnwrapProcess` with the same result."""

    def __init__(self, mesh: Triangles | Surface, texture: int, folder: Path, tiles: int) -> None:
        self._mesh, self._texture, self._tiles = Triangles(mesh.vertices, mesh.faces), texture, tiles

    def result(self, cancelled: Callable[[], bool]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return unwrap(self._mesh, self._texture, self._tiles)

    def close(self) -> None:
        pass


def unwrap_here(patch: pytest.MonkeyPatch) -> None:
    """Let jobs unwrap in this process."""
    patch.setattr(pipeline, "UnwrapProcess", _Unwrapping)
