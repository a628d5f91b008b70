# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of the photometric loss: SSIM by torch's convolutions."""

from __future__ import annotations

import torch

from ..constants import SSIM_C1, SSIM_C2, SSIM_TAPS


def photometric_reference(x: torch.Tensor, y: torch.Tensor, ssim_weight: float = 0.2) -> torch.Tensor:
    """Compute (1 - s) mean |x - y| + s (1 - mean SSIM).

    Args:
        x: (3, H, W) float64 rendered image.
        y: (3, H, W) float64 image to match.
        ssim_weight: s in 0..1.

    Returns:
        Scalar loss.
    """
    taps = torch.as_tensor(SSIM_TAPS).double()
    window = (taps[:, None] * taps)[None, None].repeat(3, 1, 1, 1)

    def blur(image: torch.Tensor) -> torch.Tensor:
        """Return the windowed mean (3, H, W) with zeros outside the image."""
        return torch.nn.functional.conv2d(image[None], window, padding=len(taps) // 2, groups=3)[0]

    mx, my = blur(x), blur(y)
    vx, vy, vxy = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
    c1, c2 = float(SSIM_C1), float(SSIM_C2)
    ssim = (2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
    return (1 - ssim_weight) * (x - y).abs().mean() + ssim_weight * (1 - ssim.mean())
