# SPDX-License-Identifier: GPL-3.0-or-later
"""A light made ready for relighting: looked up as it is by the surface seen, prefiltered by what that surface reflects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..shading.sampling import LightDistribution
from ..shading.split_sum import diffuse_light, specular_light
from ..stages.render import reduced


@dataclass(frozen=True, eq=False)
class PreparedLight:
    """Built once per light.

    Attributes:
        radiance: (H, W, 3) linear, lat-long.
        distribution: for drawing directions by radiance; None where the light has no power.
        diffuse: (h, w, 3) irradiance / pi. specular: (L, h, w, 3) stack filtered per roughness.
    """

    radiance: torch.Tensor
    distribution: LightDistribution | None
    diffuse: torch.Tensor
    specular: torch.Tensor


def prepare(light: np.ndarray) -> PreparedLight:
    """A light map (H, W, 3), finite and >= 0, with all that is derived from it."""
    radiance = torch.from_numpy(np.ascontiguousarray(light, np.float32))
    small = reduced(light)
    distribution = LightDistribution(radiance) if float(radiance.max()) > 0 else None
    return PreparedLight(radiance, distribution, diffuse_light(small), specular_light(small))
