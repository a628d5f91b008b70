# SPDX-License-Identifier: GPL-3.0-or-later
"""Real spherical harmonics (SH) up to degree 3 and the radiance that they hold, in the order and with the signs of 3DGS (Kerbl 2023).

The kernels evaluate the same functions in numba and Warp; these are differentiable PyTorch, in the precision of their arguments.
"""

from __future__ import annotations

import torch

SH_C0 = 0.28209479177387814
SH_C1 = 0.4886025119029199
SH_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
SH_C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def sh_basis(direction: torch.Tensor, degree: int) -> torch.Tensor:
    """Evaluate real spherical harmonics.

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


def sh_radiance(sh: torch.Tensor, towards: torch.Tensor) -> torch.Tensor:
    """Evaluate the radiance of surfels, max(0.5 + SH, 0), with the SH of the direction from the eye.

    Args:
        sh: (16, 3, N) coefficients of linear radiance, as in `Gaussians`.
        towards: (3, N) unit directions from the surfels to the eye, world.

    Returns:
        (3, N) linear radiance >= 0.
    """
    return ((sh_basis(-towards, 3)[:, None] * sh).sum(0) + 0.5).clamp_min(0)
