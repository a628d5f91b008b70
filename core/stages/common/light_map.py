# SPDX-License-Identifier: GPL-3.0-or-later
"""Light maps that are optimised: their smoothness and their size."""

from __future__ import annotations

import math

import torch

from ...machine.backend import by_warp

LIGHT_SLOPE = 4.1  # change of the log light per radian from which it counts as an edge; 0.2 between texels of a map of 64 rows


def light_variation(log_light: torch.Tensor) -> torch.Tensor:
    """Return the variation of a light map, robust so that windows and lamps keep sharp outlines.

    Each pair of neighbouring texels costs c^2 log(1 + (d / c)^2) with c = LIGHT_SLOPE times the texel's width: d^2 for a small
    difference d, hardly more for a larger one.

    Args:
        log_light: (H, W, 3) log radiance, lat-long; it wraps around in W.

    Returns:
        The mean over pairs along rows, plus that along columns.
    """
    edge = LIGHT_SLOPE * math.pi / len(log_light)
    if by_warp(log_light) and log_light.dtype == torch.float32:
        from ...kernels.warp.light_map import LightVariation  # Warp is an optional dependency

        return LightVariation.apply(log_light, edge)
    across, down = log_light - torch.roll(log_light, 1, 1), log_light[1:] - log_light[:-1]
    return _robust_mean(across, edge) + _robust_mean(down, edge)


def _robust_mean(difference: torch.Tensor, edge: float) -> torch.Tensor:
    """Return the mean cost of differences (...,) for c = `edge`, a scalar."""
    return edge**2 * (difference / edge).square().log1p().mean()


def resized_light(light: torch.Tensor, height: int) -> torch.Tensor:
    """Return a light map (h, w, 3) with a number of rows, at least its own."""
    return light.contiguous() if light.shape[0] >= height else resampled_light(light, height)


def resampled_light(light: torch.Tensor, height: int) -> torch.Tensor:
    """Resample a light map bilinearly; a smaller one is not averaged over its larger texels.

    Args:
        light: (h, 2h, 3) radiance, lat-long.
        height: rows of the result, more or fewer than its own.

    Returns:
        (height, 2 height, 3) radiance.
    """
    planes = light.permute(2, 0, 1)[None]
    return torch.nn.functional.interpolate(planes, size=(height, 2 * height), mode="bilinear")[0].permute(1, 2, 0).contiguous()
