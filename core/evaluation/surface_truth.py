# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of the true surface, from the point cloud or mesh that a dataset's format provides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import KDTree

from ..datasets.sparse_points import read_points
from ..errors import InputError
from ..io.npz import read_arrays

SAMPLES = 30_000
NEIGHBOURS = 16  # points that a normal is fitted to
SEED = 0


def surface_points(format: str, folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Read samples of the true surface: the point cloud of glossy-synthetic, or the scan of stanford-orb.

    Args:
        format: of the dataset.
        folder: of the dataset.

    Returns:
        Positions (N, 3) and unit normals (N, 3) in the dataset's frame; None where no true surface is provided.

    Raises:
        InputError: when a file is damaged.
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
    """Read the surface samples of a dataset that scripts/render_dataset.py wrote: positions (N, 3), unit normals (N, 3).

    Returns:
        None where the dataset has none.

    Raises:
        InputError: when the file is damaged.
    """
    path = folder / "surface_points.npz"
    if not path.is_file():
        return None
    position, normal = read_arrays(path, "points", "normals")
    if position.dtype.kind != "f" or normal.dtype.kind != "f" or not position.shape == normal.shape == (*position.shape[:1], 3):
        raise InputError(
            path,
            f"must hold points and normals of shape (N, 3), but holds {position.dtype} {position.shape}, {normal.dtype} {normal.shape}",
        )
    if not len(position) or not np.isfinite(position).all() or not np.isfinite(normal).all():
        raise InputError(path, "holds no points, or some that are not finite", "render the dataset again")
    return position, normal


def _normals(position: np.ndarray) -> np.ndarray:
    """Fit unit normals (N, 3) to the nearest neighbours of points (N, 3); their sign is arbitrary."""
    _, near = KDTree(position).query(position, k=min(NEIGHBOURS, len(position)))
    around = position[near] - position[near].mean(1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))[1][:, :, 0]


def _sampled(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Draw SAMPLES points on a mesh file, uniformly by area, with the unit normals of their triangles."""
    try:
        mesh = trimesh.load_mesh(file, process=False, skip_materials=True)
        assert isinstance(mesh, trimesh.Trimesh)
        position, face, *_ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=SEED)
        return np.asarray(position), np.asarray(mesh.face_normals[face])
    except Exception as error:  # trimesh raises errors of many types for broken files
        raise InputError(file, f"not a readable mesh ({error})") from error
