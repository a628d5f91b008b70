# SPDX-License-Identifier: GPL-3.0-or-later
"""The two scenes that secondary rays can be asked about, by name."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ..errors import InputError
from ..scene.ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from .gaussian_query import GaussianQuery
from .mesh_query import MeshQuery
from .query import SurfaceQuery

Backend = Literal["gaussian", "mesh"]


def open_query(run: Path, reconstruction: Reconstruction, backend: Backend) -> SurfaceQuery:
    """The query backend of a run. Raises InputError where the run lacks what it needs."""
    if backend == "gaussian":
        return GaussianQuery(reconstruction)
    if not (run / "mesh.ply").is_file():
        fix = f"make it by: irgspp reconstruct DATASET -o {run} --resume"
        raise InputError(run / "mesh.ply", "is missing, which --backend mesh needs", fix)
    return MeshQuery(load_mesh_ply(run / "mesh.ply"), reconstruction.bound.radius)
