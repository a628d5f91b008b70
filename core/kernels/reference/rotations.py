# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of the surfels' rotations."""

from __future__ import annotations

import torch


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
