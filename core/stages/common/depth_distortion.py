# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth distortion (2DGS, Huang 2024): surfels that a ray meets one behind the other are drawn together.

L_d = sum_{i<j} w_i w_j (z_i - z_j)^2 = A sum w_i z_i^2 - (sum w_i z_i)^2 for a pixel with the weights w_i of sum A. Here z_i is the depth
of a surfel's centre in place of the hit's: it is one value for a whole image, so that the rasteriser composites it as any other channel.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ...scene.camera import Camera
from ...scene.gaussians import Gaussians


def depth_moments(gaussians: Gaussians, camera: Camera, centre: Sequence[float] | torch.Tensor, radius: float) -> torch.Tensor:
    """Return the depth of each surfel's centre behind that of the scene, in scene radii, and its square: (2, N).

    Args:
        gaussians: N surfels.
        camera: camera of the image.
        centre: (3,) of the scene, world: with depths around 0, `depth_distortion` is exact in float32.
        radius: of the scene, world units.
    """
    position = gaussians.position
    forward, middle = (torch.as_tensor(vector, dtype=position.dtype, device=position.device) for vector in (camera.forward, centre))
    depth = forward @ (position - middle[:, None]) / radius
    return torch.stack([depth, depth.square()])


def depth_distortion(moments: torch.Tensor, alpha: torch.Tensor) -> torch.Tensor:
    """Return the mean of L_d over all pixels, in squared scene radii.

    Args:
        moments: (2, H, W) composited `depth_moments`.
        alpha: (H, W) opacity.
    """
    return (alpha * moments[1] - moments[0].square()).mean()
