# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays of a camera for the losses, and the smoothness of the light map."""

from __future__ import annotations

import torch

from ...scene.camera import Camera


def camera_rays(camera: Camera) -> torch.Tensor:
    """Return (3, H, W) float32 rays through the pixel centres in OpenCV's camera axes with z = 1: planar depth times ray is the point."""
    x = (torch.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (torch.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    y, x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([x, y, torch.ones_like(x)]).float()


def light_variation(log_light: torch.Tensor) -> torch.Tensor:
    """Return the mean squared difference of neighbouring texels of a lat-long map (H, W, 3) of log radiance, which wraps around in W."""
    across = log_light - torch.roll(log_light, 1, 1)
    return across.square().mean() + (log_light[1:] - log_light[:-1]).square().mean()
