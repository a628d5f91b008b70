# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays of a camera for the losses, and the smoothness of the light map."""

from __future__ import annotations

import math

import torch

from ...scene.camera import Camera

LIGHT_SLOPE = 4.1  # change of the log light per radian from which it counts as an edge; 0.2 between texels of a map of 64 rows


def camera_rays(camera: Camera) -> torch.Tensor:
    """Return (3, H, W) float32 rays through the pixel centres in OpenCV's camera axes with z = 1: planar depth times ray is the point."""
    x = (torch.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (torch.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    y, x = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([x, y, torch.ones_like(x)]).float()


def light_variation(log_light: torch.Tensor) -> torch.Tensor:
    """Return the variation of a light map, robust so that windows and lamps keep sharp outlines.

    Each pair of neighbouring texels costs c^2 log(1 + (d / c)^2) with c = LIGHT_SLOPE times the texel's width: d^2 for a small
    difference d, hardly more for a larger one.

    Args:
        log_light: (H, W, 3) log radiance, lat-long; it wraps around in W.

    Returns:
        The mean over pairs along rows, plus that along columns.
    """
    across, down = log_light - torch.roll(log_light, 1, 1), log_light[1:] - log_light[:-1]
    edge = LIGHT_SLOPE * math.pi / len(log_light)
    return _robust_mean(across, edge) + _robust_mean(down, edge)


def _robust_mean(difference: torch.Tensor, edge: float) -> torch.Tensor:
    """Return the mean cost of differences (...,) for c = `edge`, a scalar."""
    return edge**2 * (difference / edge).square().log1p().mean()
