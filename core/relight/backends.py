# SPDX-License-Identifier: GPL-3.0-or-later
"""A relighter for a run folder: secondary rays on its Gaussians or on its mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ..errors import InputError
from ..scene.mesh_ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from .gaussian_query import GaussianQuery
from .mesh_query import MeshQuery
from .relighter import Relighter, RelightSettings

Backend = Literal["gaussian", "mesh"]


def best_backend(run: Path) -> Backend:
    """The mesh where the run has one: as true and quicker; otherwise its Gaussians."""
    return "mesh" if (run / "mesh.ply").is_file() else "gaussian"


def open_relighter(run: Path, reconstruction: Reconstruction, backend: Backend, settings: RelightSettings) -> Relighter:
    """The relighter of a run. Raises InputError where the run lacks what it needs, or settings are impossible."""
    file, radius = run / "mesh.ply", reconstruction.bound.radius
    mesh = MeshQuery(load_mesh_ply(file), radius, reconstruction.environment.device) if file.is_file() else None
    if backend == "gaussian":
        return Relighter(reconstruction, GaussianQuery(reconstruction), settings, mesh)
    if mesh is None:
        raise InputError(file, "is missing, which --backend mesh needs", f"make it by: irgspp reconstruct DATASET -o {run} --resume")
    return Relighter(reconstruction, mesh, settings, mesh)
