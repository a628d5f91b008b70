# SPDX-License-Identifier: GPL-3.0-or-later
"""Backends of the relighter: secondary rays traced on the mesh or on the Gaussians of a run folder."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from ..errors import InputError
from ..scene.mesh_ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from .gaussian_query import GaussianQuery
from .mesh_query import MeshQuery
from .relight_settings import RelightSettings
from .relighter import Relighter

Backend = Literal["gaussian", "mesh"]


def best_backend(run: Path) -> Backend:
    """Return "mesh" where the run has a mesh, which is as accurate and faster, otherwise "gaussian"."""
    return "mesh" if (run / "mesh.ply").is_file() else "gaussian"


def open_relighter(run: Path, reconstruction: Reconstruction, backend: Backend, settings: RelightSettings) -> Relighter:
    """Open the relighter of a run.

    Args:
        run: run folder; its mesh.ply, if any, serves secondary rays (backend "mesh") and refines the shading normals (both backends).
        reconstruction: Gaussians and light of the run.
        backend: what secondary rays are traced on.
        settings: settings of the relighter.

    Raises:
        InputError: when the backend needs a mesh that the run lacks, or the settings contradict each other.
    """
    file, radius = run / "mesh.ply", reconstruction.bound.radius
    mesh = MeshQuery(load_mesh_ply(file), radius, reconstruction.environment.device) if file.is_file() else None
    if backend == "gaussian":
        return Relighter(reconstruction, GaussianQuery(reconstruction), settings, mesh)
    if mesh is None:
        raise InputError(file, "is missing, but --backend mesh needs it", f"create it: irgspp reconstruct DATASET -o {run} --resume")
    return Relighter(reconstruction, mesh, settings, mesh)
