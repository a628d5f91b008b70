# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal fit: surfels are turned until the images of their normals are those of the surface.

A pixel's normal is the mean over several surfels. Surfels that each have the surface's normal therefore show a blurred relief.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from ....kernels.rasterize import rasterize
from ....scene.dataset import View
from ....scene.gaussians import Gaussians
from ....scene.surface import Surface
from ....scene.unit_vectors import unit_vectors
from ....surface.normal_images import normal_images
from ...common.finite_check import check_due, require_finite
from ...common.optimizer import GaussianOptimizer, Rate
from ...common.training_view_cache import TrainingViewCache
from ...common.view_order import shuffled_epochs

ROTATION_RATE = Rate(2e-3, 0.1)  # learning rate of the rotations
MIN_MASK_ALPHA = 0.99  # alpha of the photograph from which a pixel counts
MIN_OPACITY = 0.5  # rendered opacity from which a pixel counts
MASK_WEIGHT = 8.0  # loss weight: opacity agrees with the mask, since surfels that turn change the object's outlines


def fit_rendered_normals(
    gaussians: Gaussians,
    surface: Surface,
    views: Sequence[View],
    radius: float,
    iterations: int,
    seed: int,
    on_step: Callable[[int], object] = lambda done: None,
    subpixels: int = 1,
) -> Gaussians:
    """Turn surfels so that their rendered normals agree with a surface's.

    Args:
        gaussians: the surfels.
        surface: mesh whose vertex normals are the goal.
        views: training views, at whose cameras the normals are compared.
        radius: radius of the scene's bound, world units.
        iterations: steps, one view each.
        seed: seed of the order of views.
        on_step: called with the number of steps done; may raise.
        subpixels: rays along each side of a pixel.

    Returns:
        The surfels with new rotations.

    Raises:
        IrgsppError: a value is not finite.
    """
    device, generator = gaussians.position.device, torch.Generator().manual_seed(seed)
    prepared = TrainingViewCache(views, crop=True)
    goals = [torch.from_numpy(image).permute(2, 0, 1) for image in normal_images(surface, [view.camera for view in prepared])]
    weights = [_weight(goal, view.alpha) for goal, view in zip(goals, prepared, strict=True)]
    optimizer = GaussianOptimizer(gaussians, {"quaternion": ROTATION_RATE})
    for done, index in enumerate(shuffled_epochs(len(views), iterations, generator)):
        g = optimizer.gaussians
        fixed = (g.log_scale.detach(), g.opacity.detach(), g.sh.detach(), g.position.new_zeros(0, g.count))
        sums, _ = rasterize(g.position.detach(), g.quaternion, *fixed, prepared[index].camera, radius, 0, subpixels)
        alpha, weight = sums[-1], weights[index].to(device)
        difference = (sums[3:6] - goals[index].to(device) * alpha).abs().sum(0)
        loss = (difference * weight * (alpha > MIN_OPACITY)).sum()
        if prepared[index].alpha is not None:
            loss = loss + MASK_WEIGHT * prepared[index].to(device).mask_difference(alpha) * alpha.numel()
        loss = loss / weight.sum().clamp_min(1)
        if check_due(loss, done + 1):
            require_finite({"the normals' loss": loss}, f"at iteration {done + 1}")
        loss.backward()
        optimizer.step(done / iterations)
        on_step(done + 1)
    optimizer.check_finite()
    turned = unit_vectors(optimizer.leaves["quaternion"].detach())
    return replace(gaussians, quaternion=turned)


def _weight(goal: torch.Tensor, alpha: torch.Tensor | None) -> torch.Tensor:
    """Return (H, W) 1 where a goal (3, H, W) is known and the photograph shows the object alone, else 0."""
    known = goal.square().sum(0) > 0
    return (known if alpha is None else known & (alpha > MIN_MASK_ALPHA)).float()
