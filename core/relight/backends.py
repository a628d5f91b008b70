# SPDX-License-Identifier: GPL-3.0-or-later
"""Backends of the relighter: secondary rays traced on the mesh or on the Gaussians of a run folder."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import torch

from ..errors import InputError
from ..scene.mesh_ply import load_mesh_ply
from ..scene.reconstruction import Reconstruction
from .gaussian_query import GaussianQuery
from .mesh_query import MeshQuery
from .mesh_texture import load_albedo_texture, load_normal_texture
from .relight_settings import RelightSettings
from .relighter import Relighter

Backend = Literal["gaussian", "mesh"]


def best_backend(run: Path) -> Backend:
    """Return "mesh" where the run has a mesh, which is as accurate and faster, otherwise "gaussian"."""
    return "mesh" if (run / "mesh.ply").is_file() else "gaussian"


def load_mesh_query(run: Path, radius: float, device: torch.device) -> MeshQuery | None:
    """Load the mesh of a run with its normal texture, and its albedo texture where that is finer than the Gaussians; None without a mesh.

    Args:
        run: run folder.
        radius: scene radius.
        device: device that rays come from.

    Raises:
        InputError: if a file can't be read.
    """
    file = run / "mesh.ply"
    if not file.is_file():
        return None
    mesh = load_mesh_ply(file)
    return MeshQuery(mesh, radius, device, load_albedo_texture(run, mesh, device), load_normal_texture(run, mesh, device))


def open_relighter(run: Path, reconstruction: Reconstruction, backend: Backend, settings: RelightSettings) -> Relighter:
    """Open the relighter of a run.

    Args:
        run: run folder; its mesh.ply, if any, serves secondary rays (backend "mesh") and refines normals and albedo (both backends).
        reconstruction: Gaussians and light of the run.
        backend: what secondary rays are traced on.
        settings: settings of the relighter.

    Raises:
        InputError: when the backend needs a mesh that the run lacks, or the settings contradict each other.
    """
    mesh = load_mesh_query(run, reconstruction.bound.radius, reconstruction.environment.device)
    if backend == "gaussian":
        return Relighter(reconstruction, GaussianQuery(reconstruction), settings, mesh)
    if mesh is None:
        fix = f"create it: irgspp reconstruct DATASET -o {run} --resume"
        raise InputError(run / "mesh.ply", "is missing, but --backend mesh needs it", fix)
    return Relighter(reconstruction, mesh, settings, mesh)
