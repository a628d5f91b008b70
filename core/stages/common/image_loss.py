# SPDX-License-Identifier: GPL-3.0-or-later
"""Loss of a rendered training view: photometric loss, difference from the mask, and normal consistency."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ...kernels.image_loss import MIN_PIXELS, MaskedTarget, masked_loss
from ...kernels.normal_consistency import normal_consistency
from ...kernels.photometric import photometric_loss
from ...rendering.deferred import composite
from .depth_distortion import depth_distortion
from .training_view import TrainingView


@dataclass(frozen=True)
class LossWeights:
    """Weights of the losses beside the photometric one.

    Attributes:
        mask: weight of the difference from the mask, where there is one.
        normal: weight of the normal consistency.
        edge: disagreement of normals that counts half, see `normal_consistency`; infinite: all count in full.
        distortion: weight of the depth distortion.
    """

    mask: float
    normal: float
    edge: float = math.inf
    distortion: float = 0.0


def displayed(straight: torch.Tensor, alpha: torch.Tensor, view: TrainingView, background: torch.Tensor | None) -> torch.Tensor:
    """Composite an image and encode it as sRGB, (3, H, W).

    Args:
        straight: (3, H, W) linear radiance with straight alpha.
        alpha: (H, W) opacity.
        view: rays, and the photograph's background in the mask's band.
        background: (h, w, 3) linear lat-long map; None where masks separate the object from its background.
    """
    image = composite(straight, alpha, view.world_rays, background, view.light_rotation)
    return view.completed(image, straight, alpha)


def image_loss(
    straight: torch.Tensor,
    sums: torch.Tensor,
    view: TrainingView,
    background: torch.Tensor | None,
    weights: LossWeights,
) -> torch.Tensor:
    """Compute the loss of a rendered view, a mean over all pixels of the photograph: it is 0 at those that were cropped away.

    Args:
        straight: (3, H, W) linear radiance with straight alpha.
        sums: (C, H, W) of `rasterize`; with depth distortion, the last extra channels are `depth_moments`.
        view: image to match.
        background: (h, w, 3) linear lat-long map; None where masks separate the object from its background.
        weights: weights of the losses.
    """
    further = 0.0
    if weights.distortion > 0:
        further = weights.distortion * view.pixel_fraction * depth_distortion(sums[-4:-2], sums[-1])
    exact = view.alpha is not None and view.band is None and background is None
    if exact and sums.dtype == torch.float32 and sums[0].numel() >= MIN_PIXELS:
        assert view.alpha is not None
        geometry = (view.rays, view.rotation)
        weighted = weights.mask, weights.normal, weights.edge
        target = MaskedTarget(view.image, view.alpha, view.saturated, *geometry, *weighted, view.pixel_fraction)
        return masked_loss(straight, sums, target) + further
    return image_loss_reference(straight, sums, view, background, weights) + further


def image_loss_reference(
    straight: torch.Tensor,
    sums: torch.Tensor,
    view: TrainingView,
    background: torch.Tensor | None,
    weights: LossWeights,
) -> torch.Tensor:
    """Compute `image_loss` without depth distortion, loss by loss, for any view and device.

    Args:
        straight: (3, H, W) linear radiance with straight alpha.
        sums: (C, H, W) of `rasterize`.
        view: image to match.
        background: (h, w, 3) linear lat-long map, or None.
        weights: weights of the losses.
    """
    loss = photometric_loss(view.bounded(displayed(straight, sums[-1], view, background)), view.image)
    if view.alpha is not None:
        loss = loss + weights.mask * view.mask_difference(sums[-1])
    return (loss + weights.normal * normal_consistency(sums, view.rays, view.rotation, weights.edge)) * view.pixel_fraction
