# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of the true surface, from what each format has of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import KDTree

from ..datasets.sparse_points import read_points
from ..errors import InputError
from ..io.npz import read_arrays

SAMPLES = 30_000
NEIGHBOURS = 16  # that say which way the surface faces
SEED = 0


def surface_points(format: str, folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions (N, 3) and unit normals (N, 3) in the dataset's frame, or None where nothing is known.

    Raises InputError for damaged files.
    """
    cloud = folder / "eval_pts.ply"
    if format == "glossy-synthetic" and cloud.is_file():
        position = read_points(cloud).position.astype(np.float64)
        return position, _normals(position)
    mesh = folder.resolve().parent.parent / "ground_truth" / folder.resolve().name / "mesh_blender" / "mesh.obj"
    if format == "stanford-orb" and mesh.is_file():
        return _sampled(mesh)
    return None


def rendered_points(folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """The same of a dataset that scripts/render_dataset.py wrote."""
    path = folder / "surface_points.npz"
    if not path.is_file():
        return None
    position, normal = read_arrays(path, "points", "normals")
    if position.dtype.kind != "f" or normal.dtype.kind != "f" or not position.shape == normal.shape == (*position.shape[:1], 3):
        raise InputError(path, f"holds no points and normals (N, 3), but {position.dtype} {position.shape}, {normal.dtype} {normal.shape}")
    if not len(position) or not np.isfinite(position).all() or not np.isfinite(normal).all():
        raise InputError(path, "holds no points, or some that are not finite")
    return position, normal


def _normals(position: np.ndarray) -> np.ndarray:
    """(N, 3) unit normals of planes through the nearest neighbours; which of both sides they face is not known."""
    _, near = KDTree(position).query(position, k=min(NEIGHBOURS, len(position)))
    around = position[near] - position[near].mean(1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))[1][:, :, 0]


def _sampled(file: Path) -> tuple[np.ndarray, np.ndarray]:
    try:
        mesh = trimesh.load_mesh(file, process=False, skip_materials=True)
        assert isinstance(mesh, trimesh.Trimesh)
        position, face, *_ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=SEED)
        return np.asarray(position), np.asarray(mesh.face_normals[face])
    except Exception as error:  # trimesh raises many kinds for broken files
        raise InputError(file, f"not a readable mesh ({error})") from error
