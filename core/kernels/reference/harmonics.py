# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of real spherical harmonics and of the surfels' rotations."""

from __future__ import annotations

import torch

from ..constants import SH_C0, SH_C1, SH_C2, SH_C3


def sh_basis(direction: torch.Tensor, degree: int) -> torch.Tensor:
    """Evaluate real spherical harmonics, in the order and with the signs of 3DGS.

    Args:
        direction: (3, N) unit directions.
        degree: highest degree, 0..3.

    Returns:
        ((degree + 1)^2, N) values.
    """
    x, y, z = direction
    c2, c3 = SH_C2, SH_C3
    rows = [torch.full_like(x, SH_C0), -SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    rows += [c2[0] * x * y, c2[1] * y * z, c2[2] * (2 * z * z - x * x - y * y), c2[3] * x * z, c2[4] * (x * x - y * y)]
    rows += [c3[0] * y * (3 * x * x - y * y), c3[1] * x * y * z, c3[2] * y * (4 * z * z - x * x - y * y)]
    rows += [c3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y), c3[4] * x * (4 * z * z - x * x - y * y)]
    rows += [c3[5] * z * (x * x - y * y), c3[6] * x * (x * x - 3 * y * y)]
    return torch.stack(rows[: (degree + 1) ** 2])


def rotation_matrix(quaternion: torch.Tensor) -> torch.Tensor:
    """Convert quaternions (4, N) w x y z of any length to rotations (3, 3, N); columns are the tangents and the normal."""
    w, x, y, z = quaternion / quaternion.norm(dim=0)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )
