# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance refit: SH and, for glossy objects, reflections are fitted again after normals have changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from ...kernels.photometric import photometric_loss
from ...kernels.rasterize import rasterize
from ...rendering.deferred import composite, radiance
from ...scene.dataset import View
from ...scene.reconstruction import Reconstruction, Reflections
from ..common.finite_check import check_due, require_finite
from ..common.optimizer import GaussianOptimizer, Rate
from ..common.training_view import TrainingView
from ..common.training_view_cache import TrainingViewCache
from ..common.view_order import shuffled_epochs

MIN_RADIANCE = 1e-6  # least radiance of the light's texels, whose logarithm is optimised
LOGIT_MARGIN = 1e-4  # materials are kept this far inside 0..1, so that their logits are finite


def refit_radiance(
    reconstruction: Reconstruction,
    views: Sequence[View],
    iterations: int,
    seed: int,
    on_step: Callable[[int], object] = lambda done: None,
    subpixels: int = 1,
) -> Reconstruction:
    """Fit the radiance to the images with geometry fixed; materials and light for relighting are not changed.

    Args:
        reconstruction: result of the refinement.
        views: training images.
        iterations: steps, one view each.
        seed: seed of the order of views.
        on_step: called with the number of steps done; it may raise, and ends the fit early by returning True.
        subpixels: rays along each side of a pixel.

    Returns:
        The reconstruction with new SH and reflections.

    Raises:
        IrgsppError: a value is not finite.
    """
    mirrored, g = reconstruction.mirrored(), reconstruction.gaussians
    own = g if mirrored is None else replace(g, material=torch.logit(mirrored.material.clamp(LOGIT_MARGIN, 1 - LOGIT_MARGIN)))
    rates, others = {"sh_dc": Rate(3e-3, 0.1), "sh_rest": Rate(2e-4, 0.1)}, {}
    if mirrored is not None:
        others["light"] = mirrored.environment.clamp_min(MIN_RADIANCE).log().contiguous().requires_grad_()
        rates |= {name: Rate(3e-3, 0.1) for name in ("albedo", "roughness", "metallic", "light")}
    optimizer, generator = GaussianOptimizer(own, rates, others), torch.Generator().manual_seed(seed)
    training_views = TrainingViewCache(views, crop=True, device=g.position.device)
    for done, index in enumerate(shuffled_epochs(len(training_views), iterations, generator)):
        loss = _loss(optimizer, reconstruction, training_views[index], others.get("light"), subpixels)
        if check_due(loss, done + 1):
            require_finite({"the radiance's loss": loss}, f"at iteration {done + 1}")
        loss.backward()
        optimizer.step(done / iterations)
        if on_step(done + 1):
            break
    optimizer.check_finite()
    fitted = optimizer.gaussians
    gaussians = replace(g, sh=fitted.sh.detach().clone())
    reflections = None
    if mirrored is not None:
        reflections = Reflections(fitted.materials().detach().clone(), others["light"].detach().exp())
    return replace(reconstruction, gaussians=gaussians, reflections=reflections)


def _loss(
    optimizer: GaussianOptimizer, reconstruction: Reconstruction, view: TrainingView, light: torch.Tensor | None, subpixels: int
) -> torch.Tensor:
    """Compute the photometric loss of one view; `light` (H, 2H, 3) is the log radiance of the reflected light, None without reflections."""
    g = optimizer.gaussians
    extra = g.position.new_zeros(0, g.count) if light is None else g.materials()
    geometry = (g.position.detach(), g.quaternion.detach(), g.log_scale.detach(), g.opacity.detach())
    sums, _ = rasterize(*geometry, g.sh, extra, view.camera, reconstruction.bound.radius, subpixels=subpixels)
    straight = radiance(sums, view.world_rays, None if light is None else light.exp(), view.light_rotation)
    image = composite(straight, sums[-1], view.world_rays, reconstruction.background, view.light_rotation)
    # As if the black around the object were there: each pixel counts the same in all views.
    return view.pixel_fraction * photometric_loss(view.bounded(view.completed(image, straight, sums[-1])), view.image)
