# SPDX-License-Identifier: GPL-3.0-or-later
"""The Gaussians' own radiance fitted again after their normals have moved: SH, and where there are any, reflections."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from ...kernels.photometric import photometric_loss
from ...kernels.rasterize import rasterize
from ...rendering.deferred import composite, radiance
from ...scene.dataset import View
from ...scene.reconstruction import Reconstruction, Reflections
from ..common.finite_check import due, require_finite
from ..common.optimizer import GaussianOptimizer, Rate
from ..common.training_view import TrainingView, make_training_view

DARKEST = 1e-6  # of the light's texels, whose logarithm is optimised
EDGE = 1e-4  # materials stay this far inside 0..1: their logits are finite


def refit_radiance(
    reconstruction: Reconstruction, views: Sequence[View], iterations: int, seed: int, step: Callable[[int], object] = lambda done: None
) -> Reconstruction:
    """A short run of the first stage with geometry as it is; materials and light for relighting are left alone.

    `step` is told how many iterations are done; it may raise, and ends the run where it returns True.
    """
    mirrored, g = reconstruction.mirrored(), reconstruction.gaussians
    own = g if mirrored is None else replace(g, material=torch.logit(mirrored.material.clamp(EDGE, 1 - EDGE)))
    rates, others = {"sh_dc": Rate(3e-3, 0.1), "sh_rest": Rate(2e-4, 0.1)}, {}
    if mirrored is not None:
        others["light"] = mirrored.environment.clamp_min(DARKEST).log().contiguous().requires_grad_()
        rates |= {name: Rate(3e-3, 0.1) for name in ("albedo", "roughness", "metallic", "light")}
    optimizer, generator = GaussianOptimizer(own, rates, others), torch.Generator().manual_seed(seed)
    targets = [make_training_view(view).to(g.position.device) for view in views]
    order = torch.cat([torch.randperm(len(targets), generator=generator) for _ in range(math.ceil(iterations / len(targets)))])
    for done, index in enumerate(order[:iterations].tolist()):
        loss = _loss(optimizer, reconstruction, targets[index], others.get("light"))
        if due(loss, done + 1):
            require_finite({"the radiance's loss": loss}, f"at iteration {done + 1}")
        loss.backward()
        optimizer.step(done / iterations)
        if step(done + 1):
            break
    optimizer.check_finite()
    fitted = optimizer.gaussians
    gaussians = replace(g, sh=fitted.sh.detach().clone())
    reflections = None
    if mirrored is not None:
        reflections = Reflections(fitted.materials().detach().clone(), others["light"].detach().exp())
    return replace(reconstruction, gaussians=gaussians, reflections=reflections)


def _loss(optimizer: GaussianOptimizer, reconstruction: Reconstruction, target: TrainingView, light: torch.Tensor | None) -> torch.Tensor:
    g = optimizer.gaussians
    extra = g.position.new_zeros(0, g.count) if light is None else g.materials()
    geometry = (g.position.detach(), g.quaternion.detach(), g.log_scale.detach(), g.opacity.detach())
    sums, _ = rasterize(*geometry, g.sh, extra, target.camera, reconstruction.bound.radius)
    straight = radiance(sums, target.world_rays, None if light is None else light.exp())
    image = composite(straight, sums[-1], target.world_rays, reconstruction.background)
    return photometric_loss(target.bounded(image), target.image)
