# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of Gaussian splats that shares no code with the writer: the layout of INRIA's 3DGS, as SuperSplat and other viewers read it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

C0 = 0.28209479177387814  # the constant spherical harmonic


@dataclass(frozen=True)
class Splats:
    """Splats in the world, +Z up: a viewer turns the file, whose up is -Y.

    Attributes:
        place: (N, 3).
        covariance: (N, 3, 3).
        opacity: (N,) in 0..1.
        colour: (N, 3) sRGB, without its change with the direction.
        rest: (N, 45) coefficients of that change.
    """

    place: np.ndarray
    covariance: np.ndarray
    opacity: np.ndarray
    colour: np.ndarray
    rest: np.ndarray


def read_splats(path: Path) -> Splats:
    """Read a little-endian PLY whose vertices are floats."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    assert lines[1] == "format binary_little_endian 1.0"
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    table = np.frombuffer(body, np.dtype([(name, "<f4") for name in names]))
    assert f"element vertex {len(table)}" in lines
    columns = lambda *wanted: np.stack([table[name] for name in wanted], -1).astype(np.float64)  # noqa: E731
    upright = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # the file's -Y becomes +Z
    w, *xyz = columns("rot_0", "rot_1", "rot_2", "rot_3").T
    axes = upright @ Rotation.from_quat(np.stack([*xyz, w], -1)).as_matrix() * np.exp(columns("scale_0", "scale_1", "scale_2"))[:, None]
    return Splats(
        columns("x", "y", "z") @ upright.T,
        axes @ axes.transpose(0, 2, 1),
        1 / (1 + np.exp(-columns("opacity")[:, 0])),
        0.5 + C0 * columns("f_dc_0", "f_dc_1", "f_dc_2"),
        columns(*(f"f_rest_{i}" for i in range(45))),
    )
