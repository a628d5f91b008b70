# SPDX-License-Identifier: GPL-3.0-or-later
"""Losses of the joint optimisation, with the weights that IRGS publishes for its second stage.

| term | formula | weight |
|---|---|---|
| radiance | 0.8 L1 + 0.2 (1 - SSIM) of the image of the Gaussians' own radiance | 1 |
| pixels | L1 of the shaded pixels, encoded and composited | 1 |
| normal | 1 - splatted normal . normal of the depth (2DGS), from a tenth of the schedule on | 0.05 |
| normal_smoothness | edge-aware, likewise | 0.01 |
| mask | binary cross entropy of opacity and mask | 0.01 |
| albedo, roughness, metallic | edge-aware smoothness in the image | see `Weights` |
| white_balance | deviation of the incoming light from grey | 0.1 |
| light | total variation of the light seen behind the view | 5e-4 |
| distortion | depth distortion (2DGS); left out where its weight is 0, as in Ref-Gaussian's and IRGS's scripts | 0 |
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ....io.srgb import encode_srgb
from ....kernels.normal_consistency import normal_consistency
from ....kernels.rasterize import EXTRA, NORMAL
from ....scene.gaussians import Gaussians
from ....scene.unit_vectors import unit_vectors
from ....shading.environment_lookup import lookup
from ...common.depth_distortion import depth_distortion
from ...common.training_view import BAND_WEIGHT, TrainingView
from .model import JointModel, PixelPlan, at_pixels

MOMENTS = slice(EXTRA + 5, EXTRA + 7)  # of depth, behind the materials
NORMALS_FROM = 0.1  # fraction of the schedule from which the geometry's losses count: 1000 of 10,000 iterations
MIN_OPACITY = 0.05  # opacity from which a pixel's layers are divided by it and smoothed
ENTROPY_FLOOR = 1e-6  # distance of an opacity from 0 and 1 in the mask's cross entropy


@dataclass(frozen=True)
class Weights:
    """Loss weights.

    Attributes:
        normal: normal consistency.
        normal_smoothness: edge-aware smoothness of normals.
        mask: cross entropy of opacity and mask.
        albedo: edge-aware smoothness.
        roughness: edge-aware smoothness.
        metallic: edge-aware smoothness.
        white_balance: deviation of the incoming light from grey.
        light: variation of the light map.
        distortion: depth distortion.
    """

    normal: float = 0.05
    normal_smoothness: float = 0.01
    mask: float = 0.01
    albedo: float = 2.0
    roughness: float = 2.0
    metallic: float = 2.0  # IRGS renders no metal; weighted as roughness
    white_balance: float = 0.1
    light: float = 5e-4
    distortion: float = 0.0


LOW_GLOSS_WEIGHTS = Weights()
# IRGS publishes none for glossy objects, whose materials vary more and whose reflections show the light's colour. Those of its
# descendants are a tenth: RadioGS 0.2 and 0.1, GS-ROR 0.01.
GLOSSY_WEIGHTS = Weights(albedo=0.2, roughness=0.2, metallic=0.2, white_balance=0.01)


def joint_losses(
    model: JointModel,
    gaussians: Gaussians,
    log_light: torch.Tensor,
    sums: torch.Tensor,
    view: TrainingView,
    plan: PixelPlan,
    weights: Weights,
    geometry: bool,
) -> dict[str, torch.Tensor]:
    """Compute the weighted losses of one view.

    Args:
        model: constants.
        gaussians: N surfels.
        log_light: (h, w, 3) log radiance.
        sums: of `JointModel.render`.
        view: photograph.
        plan: pixels and light samples.
        weights: loss weights.
        geometry: normal consistency and smoothness count.

    Returns:
        Scalars by the names of the module's table; their sum is the loss. Means over the image count by the fraction of it that is kept.
    """
    light = log_light.exp()
    few, alpha = at_pixels(view, plan.pixels), sums[-1].flatten().index_select(0, plan.pixels)
    radiance, incoming = model.shade(gaussians, light, sums, view, plan)
    shaded = model.composited(radiance.T[:, None], alpha[None], few)
    image = {"radiance": model.kernels.photometric(model.radiance_image(sums, view), view.image)}
    if view.alpha is not None:
        image["mask"] = weights.mask * mask_entropy(sums[-1], view)
    if geometry:
        image["normal"] = weights.normal * normal_consistency(sums, view.rays, view.rotation)
        image["normal_smoothness"] = weights.normal_smoothness * edge_aware_smoothness(*visible_layers(sums, NORMAL, view), view.image)
    if weights.distortion > 0:
        image["distortion"] = weights.distortion * depth_distortion(sums[MOMENTS], sums[-1])
    for name, channels in (("albedo", slice(0, 3)), ("roughness", slice(3, 4)), ("metallic", slice(4, 5))):
        layers = visible_layers(sums, slice(EXTRA + channels.start, EXTRA + channels.stop), view)
        image[name] = getattr(weights, name) * edge_aware_smoothness(*layers, view.image)
    losses = {name: value * view.pixel_fraction for name, value in image.items()}
    losses["pixels"] = (shaded - few.image).abs().mean()
    losses["white_balance"] = weights.white_balance * white_balance(incoming, plan)
    losses["light"] = weights.light * seen_light_variation(light, view.world_rays)
    return losses


def visible_layers(sums: torch.Tensor, channels: slice, view: TrainingView) -> tuple[torch.Tensor, torch.Tensor]:
    """Return layers (C, H, W) of the sums (13, H, W) divided by opacity, 0 where nothing is, and the object's mask (H, W)."""
    alpha = sums[-1]
    layers = torch.where(alpha > MIN_OPACITY, sums[channels] / alpha.clamp_min(MIN_OPACITY), 0.0)
    return layers, torch.ones_like(alpha) if view.alpha is None else view.alpha


def sobel(image: torch.Tensor) -> torch.Tensor:
    """Return the gradient (C, 2, H, W) of an image (C, H, W) across and down: Sobel's filter with absolute weights of sum 1."""
    across = image.new_tensor([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]]) / 8
    padded = torch.nn.functional.pad(image[:, None], (1, 1, 1, 1), mode="replicate")
    return torch.nn.functional.conv2d(padded, torch.stack([across, across.T])[:, None])


def edge_aware_smoothness(values: torch.Tensor, mask: torch.Tensor, photograph: torch.Tensor) -> torch.Tensor:
    """Return the mean over pixels and channels of sum |gradient of values| exp(-|gradient of the photograph|), as IRGS computes it.

    Args:
        values: (C, H, W) with C of 1 or 3; multiplied by the mask.
        mask: (H, W) of the object.
        photograph: (3, H, W) sRGB-encoded.
    """
    return (sobel(values * mask).abs() * torch.exp(-sobel(photograph).abs())).sum(1).mean()


def mask_entropy(alpha: torch.Tensor, view: TrainingView) -> torch.Tensor:
    """Return the mean binary cross entropy of a rendered opacity (H, W) and the mask, weighted by BAND_WEIGHT in the mask's band."""
    assert view.alpha is not None
    opacity = alpha.clamp(ENTROPY_FLOOR, 1 - ENTROPY_FLOOR)
    entropy = -(view.alpha * opacity.log() + (1 - view.alpha) * (1 - opacity).log())
    return (entropy if view.band is None else torch.where(view.band, BAND_WEIGHT * entropy, entropy)).mean()


def white_balance(incoming: torch.Tensor, plan: PixelPlan) -> torch.Tensor:
    """Return the mean deviation of the light that pixels receive from grey, L1 over channels (IRGS).

    IRGS averages uniform directions. Samples of a mixture are weighted by 1 / density, and the weights divided by their sum, so that the
    mean is over solid angle whichever strategy drew the samples; a plain mean would count bright lamps again for each light sample.

    Args:
        incoming: (B, N, 3) linear radiance V L + L_ind.
        plan: its samples and which of them are above the horizon.
    """
    weight = (1 / plan.samples.density).flatten()
    over = torch.zeros_like(weight).index_copy(0, plan.above, weight.index_select(0, plan.above)).view_as(plan.samples.density)
    mean = (over[..., None] * incoming).sum(1) / over.sum(1, keepdim=True).clamp_min(1e-12)
    return (mean - mean.mean(1, keepdim=True)).abs().mean()


def seen_light_variation(light: torch.Tensor, rays: torch.Tensor) -> torch.Tensor:
    """Return the mean squared difference of neighbouring pixels of the encoded light map as a view sees it (IRGS).

    Args:
        light: (h, w, 3) linear.
        rays: (3, H, W) world directions of any length.
    """
    direction = unit_vectors(rays.flatten(1)).T
    seen = encode_srgb(lookup(light, direction)).T.view_as(rays)
    across, down = seen[:, :, 1:] - seen[:, :, :-1], seen[:, 1:] - seen[:, :-1]
    return across.square().mean() + down.square().mean()
