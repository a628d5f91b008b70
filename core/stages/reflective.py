# SPDX-License-Identifier: GPL-3.0-or-later
"""The first stage: 2D Gaussians, their radiance and, where the object is glossy, reflections of a split-sum light."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ..config import ReflectiveSettings, Settings
from ..datasets.dataset import Dataset
from ..errors import Cancelled, IrgsppError
from ..kernels.photometric import photometric_loss
from ..kernels.rasterize import rasterize
from ..progress import Checkpoint, Progress, Silent
from ..scene.gaussians import Gaussians
from ..scene.reconstruction import Reconstruction
from .appearance import separate_light
from .deferred import composite, radiance
from .density import DensityControl, reset_opacity
from .hull import initial_gaussians
from .layer import thin
from .losses import normal_consistency
from .optimizer import GaussianOptimizer, Rate
from .target import Target, make_target

START_RADIANCE = 0.5  # of the light and the background, linear
CHECKPOINT_SECONDS = 30.0
TEST_EVERY = 50  # steps between looks at the held-back view
GLOSSY_START = (0.7, 0.7, 0.7, 0.25, 0.95)  # albedo, roughness, metallic of the glossy start


def rates(radius: float, glossy: bool) -> dict[str, Rate]:
    """Learning rates; the position's follows the scene's radius."""
    table = {
        "position": Rate(8e-4 * radius, 0.05),
        "quaternion": Rate(5e-4, 0.2),
        "log_scale": Rate(6e-3, 0.2),
        "opacity": Rate(5e-2, 0.2),
        "sh_dc": Rate(2e-2, 0.1),
        "sh_rest": Rate(1e-3, 0.1),
    }
    if glossy:
        table |= {"albedo": Rate(2e-2, 0.1), "roughness": Rate(2e-2, 0.1), "metallic": Rate(1e-2, 0.1), "light": Rate(3e-2, 0.2)}
    return table


class Trainer:
    """The state of the first stage and one step of it; `run` drives it to the end of its schedule."""

    def __init__(self, dataset: Dataset, settings: ReflectiveSettings, gaussians: Gaussians, glossy: bool, seed: int, reduction: int = 1) -> None:
        self.dataset, self.settings, self.glossy = dataset, settings, glossy
        self.held_back = len(dataset.train) // 2 if len(dataset.train) >= 8 else None
        self.targets = [make_target(view, reduction) for view in dataset.train]
        self.generator = torch.Generator().manual_seed(seed)
        self.masked = dataset.has_alpha
        self.light = torch.full((settings.light_height, 2 * settings.light_height, 3), math.log(START_RADIANCE))
        self.background = torch.full((64, 128, 3), math.log(START_RADIANCE))
        others, table = {}, rates(dataset.bound.radius, glossy)
        if glossy:
            others["light"] = self.light.requires_grad_()
        if not self.masked:
            others["background"] = self.background.requires_grad_()
            table["background"] = Rate(1e-2, 0.2)
        if glossy:
            gaussians = replace(gaussians, material=torch.logit(torch.tensor(GLOSSY_START))[:, None].repeat(1, gaussians.count))
        self.optimizer = GaussianOptimizer(gaussians, table, others)
        self.density = DensityControl(settings.gaussians, dataset.bound.radius)
        self.done, self.order = 0, torch.zeros(0, dtype=torch.long)

    def render(self, target: Target, degree: int = 3):
        """The encoded picture (3, H, W), the rasterised sums and the screen statistics."""
        g, radius = self.optimizer.gaussians, self.dataset.bound.radius
        extra = g.materials() if self.glossy else torch.zeros(0, g.count)
        sums, statistics = rasterize(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra, target.camera, radius, degree)
        straight = radiance(sums, target.world_rays, self.light.exp() if self.glossy else None)
        background = None if self.masked else self.background.exp()
        return composite(straight, sums[-1], target.world_rays, background), sums, statistics

    def step(self) -> float:
        """One view, one step; returns the loss."""
        target = self.targets[self._next_view()]
        picture, sums, statistics = self.render(target)
        loss = photometric_loss(target.bounded(picture), target.picture)
        if target.alpha is not None:
            loss = loss + self.settings.mask_weight * (sums[-1] - target.alpha).abs().mean()
        loss = loss + self.settings.normal_weight * normal_consistency(sums, target.rays, target.rotation)
        if self.glossy:
            loss = loss + self.settings.light_smoothness * _roughness_of(self.light)
        value = loss.item()
        if not math.isfinite(value):
            raise IrgsppError(f"the first stage's loss is not finite at iteration {self.done + 1}")
        loss.backward()
        self.optimizer.step(self.done / self.settings.iterations)
        self.done += 1
        self._control(statistics)
        return value

    def _control(self, statistics) -> None:
        """Density control, in the middle of the schedule; a hull start has its Gaussians where they belong and is only pruned."""
        share = self.done / self.settings.iterations
        if self.masked and self.settings.thinning and self.done % self.settings.thinning == 0 and share < 0.9:
            thin(self.optimizer.gaussians, 0.5)
        if not 0.1 < share < 0.6:
            return
        if not self.masked:
            self.density.observe(statistics)
        period = max(1, self.settings.iterations // 20)
        if self.done % period == 0:
            self.density.refine(self.optimizer, self.generator)
        if not self.masked and self.done == period * 8:
            reset_opacity(self.optimizer)

    def _next_view(self) -> int:
        if not len(self.order):
            order = torch.randperm(len(self.targets), generator=self.generator)
            self.order = order[order != (self.held_back if self.held_back is not None else -1)]
        view, self.order = int(self.order[-1]), self.order[:-1]
        return view

    def test(self) -> float | None:
        """PSNR in dB on the held-back view, or None where the views are too few to hold one back."""
        if self.held_back is None:
            return None
        target = self.targets[self.held_back]
        with torch.no_grad():
            error = (self.render(target)[0].clamp(0, 1) - target.picture).square().mean()
        return -10 * math.log10(max(error.item(), 1e-10))

    def run(self, progress: Progress, checkpoint: Checkpoint | None) -> None:
        """To the end of the schedule, or until the user is content; raises Cancelled after a checkpoint."""
        saved = time.monotonic()
        while self.done < self.settings.iterations and not progress.finish_early:
            if progress.cancelled:
                if checkpoint is not None:
                    checkpoint.save("reflective", self.state())
                raise Cancelled(f"stopped at iteration {self.done} of the first stage")
            figures = {"loss": self.step()}
            if self.done % TEST_EVERY == 0 or self.done == self.settings.iterations:
                psnr = self.test()
                figures |= {} if psnr is None else {"psnr": psnr}
            progress.step(self.done, **figures)
            if checkpoint is not None and time.monotonic() - saved > CHECKPOINT_SECONDS:
                checkpoint.save("reflective", self.state())
                saved = time.monotonic()

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the schedule depends on."""
        density = {"gradient": self.density.gradient, "seen": self.density.seen}
        order = {"order": self.order, "generator": self.generator.get_state()}
        return {"done": self.done, "glossy": self.glossy, "optimizer": self.optimizer.state(), **density, **order}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state`."""
        self.done, self.order = int(state["done"]), state["order"]
        self.generator.set_state(state["generator"])
        self.density.gradient, self.density.seen = state["gradient"], state["seen"]
        self.optimizer.restore(state["optimizer"])


def _roughness_of(light: torch.Tensor) -> torch.Tensor:
    """Mean squared difference of neighbours of a log light map."""
    across = light - torch.roll(light, 1, 1)
    return across.square().mean() + (light[1:] - light[:-1]).square().mean()


def is_glossy(dataset: Dataset, settings: Settings, gaussians: Gaussians, progress: Progress) -> bool:
    """Decide whether reflections explain the photographs better: fit both kinds briefly, compare on the held-back view."""
    if settings.materials != "auto":
        return settings.materials == "glossy"
    if len(dataset.train) < 8:
        return False
    longest = max(dataset.train[0].camera.width, dataset.train[0].camera.height)
    reduction = max(1, longest // settings.reflective.trial_resolution)
    index = torch.randperm(gaussians.count, generator=torch.Generator().manual_seed(settings.seed))[: settings.reflective.trial_gaussians]
    few = gaussians.select(index.sort().values)
    few.log_scale += 0.5 * math.log(gaussians.count / few.count)
    score = {}
    progress.phase("materials", 2 * settings.reflective.trial_iterations)
    for glossy in (False, True):
        brief = replace(settings.reflective, iterations=settings.reflective.trial_iterations, gaussians=few.count)
        trial = Trainer(dataset, brief, few, glossy, settings.seed, reduction)
        for _ in range(brief.iterations):
            if progress.cancelled:
                raise Cancelled("stopped while the kind of material was being decided")
            trial.step()
            progress.step(trial.done + glossy * brief.iterations)
        score[glossy] = trial.test() or 0.0
    progress.message(f"materials: {score[False]:.2f} dB without reflections, {score[True]:.2f} dB with")
    return score[True] > score[False] + settings.reflective.trial_margin


def train(dataset: Dataset, settings: Settings, progress: Progress | None = None, checkpoint: Checkpoint | None = None) -> Reconstruction:
    """Fit Gaussians to the training views.

    Goes on from the checkpoint "reflective" where there is one; the result is then that of an undisturbed run.

    Raises:
        Cancelled: the user stopped the work; the checkpoint is written. IrgsppError: the loss is not finite.
    """
    progress = progress or Silent()
    torch.manual_seed(settings.seed)
    gaussians = initial_gaussians(dataset, settings.reflective.gaussians, np.random.default_rng(settings.seed))
    state = checkpoint.load("reflective") if checkpoint is not None else None
    glossy = bool(state["glossy"]) if state is not None else is_glossy(dataset, settings, gaussians, progress)
    trainer = Trainer(dataset, settings.reflective, gaussians, glossy, settings.seed)
    if state is not None:
        trainer.restore(state)
    progress.phase("reflective", settings.reflective.iterations)
    trainer.run(progress, checkpoint)
    fitted = trainer.optimizer.gaussians.select(torch.arange(trainer.optimizer.gaussians.count))
    background = None if trainer.masked else trainer.background.detach().exp()
    result = Reconstruction(fitted, trainer.light.detach().exp(), dataset.bound, dataset.to_world, glossy, background)
    return separate_light(result, settings.seed)
