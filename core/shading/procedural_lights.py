# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural light maps: soft suns, skies and panels for demonstrations and for judging materials."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from ..io.srgb import luminance
from .environment_lookup import solid_angles, texel_directions


def map_directions(height: int, width: int) -> np.ndarray:
    """Return the unit world directions of the texel centres of a lat-long map, (H, W, 3) float64.

    Args:
        height: rows of the map.
        width: columns of the map.
    """
    return texel_directions(height, width, torch.float64).numpy()


def sky_light(height: int, width: int) -> np.ndarray:
    """Return a clear morning: a warm soft sun, a cool sky and green-brown ground, (H, W, 3) float32 linear.

    Args:
        height: rows of the map.
        width: columns of the map.
    """
    d = map_directions(height, width)
    light = _gradient(d, ground=(0.10, 0.09, 0.05), horizon=(0.75, 0.72, 0.62), zenith=(0.16, 0.30, 0.62))
    light += _sun(d, azimuth=-50, elevation=48, width=9, colour=(26, 22, 17))
    light += _panel(d, azimuth=150, elevation=15, width=50, height=30, colour=(0.35, 0.55, 0.95))
    return _exposed(light)


def studio_light(height: int, width: int) -> np.ndarray:
    """Return a grey room with a large warm key light, a cool strip light behind and a soft ceiling, (H, W, 3) float32 linear.

    Args:
        height: rows of the map.
        width: columns of the map.
    """
    d = map_directions(height, width)
    light = np.broadcast_to([0.07, 0.07, 0.075], d.shape).copy()
    light += _panel(d, azimuth=-35, elevation=35, width=55, height=45, colour=(5.0, 4.5, 3.8))
    light += _panel(d, azimuth=125, elevation=20, width=22, height=80, colour=(2.0, 2.9, 4.4))
    light += _panel(d, azimuth=-150, elevation=10, width=30, height=60, colour=(2.4, 1.3, 1.2))
    light += np.clip(d[..., 2:] - 0.75, 0, None) * np.array([5.0, 5.0, 5.0])
    return _exposed(light)


def sunset_light(height: int, width: int) -> np.ndarray:
    """Return a low orange sun under a violet sky, (H, W, 3) float32 linear.

    Args:
        height: rows of the map.
        width: columns of the map.
    """
    d = map_directions(height, width)
    light = _gradient(d, ground=(0.05, 0.035, 0.04), horizon=(0.85, 0.40, 0.28), zenith=(0.10, 0.12, 0.34))
    light += _sun(d, azimuth=70, elevation=14, width=10, colour=(40, 18, 7))
    light += _panel(d, azimuth=70, elevation=5, width=120, height=20, colour=(0.9, 0.38, 0.14))
    return _exposed(light)


LIGHTS: dict[str, Callable[[int, int], np.ndarray]] = {"sky": sky_light, "studio": studio_light, "sunset": sunset_light}


def _direction(azimuth: float, elevation: float) -> np.ndarray:
    """Return the unit vector (3,) of an azimuth and an elevation in degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _gradient(d: np.ndarray, ground, horizon, zenith) -> np.ndarray:
    """Blend ground, horizon and zenith colours (3,) over directions (H, W, 3) by their height."""
    up = d[..., 2:]
    sky = np.array(horizon) + (np.array(zenith) - np.array(horizon)) * np.clip(up, 0, 1) ** 0.5
    below = 1 / (1 + np.exp(up / 0.04))  # a soft edge: a sharp horizon would show the texels
    return sky * (1 - below) + np.array(ground) * below


def _sun(d: np.ndarray, azimuth: float, elevation: float, width: float, colour) -> np.ndarray:
    """Return a Gaussian spot of `width` degrees of standard deviation over directions (H, W, 3)."""
    cosine = d @ _direction(azimuth, elevation)
    return np.exp((cosine - 1) / np.radians(width) ** 2)[..., None] * np.array(colour)


def _panel(d: np.ndarray, azimuth: float, elevation: float, width: float, height: float, colour) -> np.ndarray:
    """Return a soft-edged rectangle over directions (H, W, 3); its centre and its sizes are azimuths and elevations in degrees."""
    across = (np.degrees(np.arctan2(d[..., 1], d[..., 0])) - azimuth + 180) % 360 - 180
    along = np.degrees(np.arcsin(np.clip(d[..., 2], -1, 1))) - elevation
    edge = 1 / ((1 + np.exp((np.abs(across) - width / 2) / 2.5)) * (1 + np.exp((np.abs(along) - height / 2) / 2.5)))
    return edge[..., None] * np.array(colour)


def _exposed(light: np.ndarray) -> np.ndarray:
    """Scale a map (H, W, 3) so that a white diffuse surface facing its brightest side has luminance 1.2.

    Images then are neither overexposed nor too dark.
    """
    height, width = light.shape[:2]
    d = map_directions(height, width).reshape(-1, 3)
    power = luminance(light * solid_angles(height, width, torch.float64).numpy()[:, None, None]).reshape(-1)
    sides = map_directions(9, 18).reshape(-1, 3)
    brightest = (np.clip(sides @ d.T, 0, None) @ power).max() / np.pi
    return (light * (1.2 / brightest)).astype(np.float32)
