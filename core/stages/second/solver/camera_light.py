# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that moves with the camera, such as its flash: how much brighter points are in the photographs that they face."""

from __future__ import annotations

from .multi_view_samples import MultiViewSamples

MAX_CHANGE = 1.0  # relative change of a sample's radiance that counts at most: mirrored lights change it more
# Slope from which a light moves with the camera: 1.3 under a real flash, -.6 to .03 on twelve objects under a light that stays.
MIN_CAMERA_LIGHT = 0.5


def moves_with_camera(samples: MultiViewSamples) -> bool:
    """Return True where the photographs were lit by a light at the camera.

    Args:
        samples: multi-view samples.
    """
    return camera_light(samples) > MIN_CAMERA_LIGHT


def camera_light(samples: MultiViewSamples) -> float:
    """Return the slope of points' relative radiance against the cosine between normal and view; 0 where nothing is seen obliquely.

    A fixed light makes a matt point equally bright in all photographs, and a glossy one brighter in a few. A light at the camera makes it
    brighter by the cosine: the slope is 1 over the mean cosine then, 1.5 to 2.

    Args:
        samples: multi-view samples.
    """
    valid = (~samples.saturated.any(1)).double()
    count = samples.sums(valid).clamp_min(1)
    radiance, cosine = samples.colour.double().mean(1), samples.n_v.double()
    mean_radiance, mean_cosine = samples.sums(valid * radiance) / count, samples.sums(valid * cosine) / count
    change = (radiance / mean_radiance[samples.point].clamp_min(1e-6) - 1).clamp(-MAX_CHANGE, MAX_CHANGE) * valid
    facing = (cosine - mean_cosine[samples.point]) * valid
    return float((change * facing).sum() / facing.square().sum().clamp_min(1e-12))
