# SPDX-License-Identifier: GPL-3.0-or-later
"""The first stage's optimisation: one view a step, from a start to the end of its schedule."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ...errors import Cancelled, InputError, IrgsppError
from ...io.srgb import decode_srgb
from ...kernels.photometric import photometric_loss
from ...kernels.rasterize import ScreenStatistics, rasterize
from ...progress.protocol import Checkpoint, Progress
from ...rendering.deferred import composite, radiance
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...settings.schema import FirstStageSettings
from ..common.finite_check import due
from ..common.losses import normal_consistency
from ..common.optimizer import GaussianOptimizer, Rate
from ..common.preview import LONGEST, eight_bits
from ..common.training_view import TrainingView, make_training_view
from .densification import DensityControl, reset_opacity
from .material_class import MOVES, MaterialClass

START_RADIANCE = 0.5  # of the light, linear
CHECKPOINT_SECONDS = 30.0
RESET_EVERY = 3000  # steps between resets of the opacity (3DGS); shorter schedules have none
HULL_LEFT = 0.4  # of the surfels at the start; photographs that fit each other take a few per cent
MEANT_FOR = 1500  # steps, that the rates at which surfels move were chosen with
TEST_EVERY = 50  # steps between looks at the held-back view


class Trainer:
    """The state of the first stage and one step of it; `run` drives it to the end of its schedule."""

    def __init__(
        self,
        dataset: Dataset,
        settings: FirstStageSettings,
        gaussians: Gaussians,
        kind: MaterialClass,
        seed: int,
        hold_back: int,
        reduction: int = 1,
        cut: bool = False,
        resident: bool = True,
    ) -> None:
        """`hold_back`: every so many views one is kept for `test`, 0 = none. `reduction`, `cut`: of the images, see `make_target`.

        `resident`: photographs are kept on the Gaussians' device, else each is brought there for its step.
        """
        self.dataset, self.settings, self.kind = dataset, settings, kind
        views = torch.arange(len(dataset.train))
        self.held_back = views % hold_back == hold_back // 2 if hold_back else views < 0
        self.device = gaussians.position.device
        home = self.device if resident else torch.device("cpu")
        self.targets = [make_training_view(view, reduction, cut).to(home) for view in dataset.train]
        self.generator = torch.Generator().manual_seed(seed)
        self.masked = dataset.has_alpha
        self.light = gaussians.position.new_full((settings.light_height, 2 * settings.light_height, 3), math.log(START_RADIANCE))
        self.background = border_radiance(self.targets).log().expand(64, 128, 3).clone().to(self.device)
        others, table = {}, kind.rates(dataset.bound.radius)
        if kind.glossy:
            others["light"] = self.light.requires_grad_()
        if not self.masked:
            others["background"] = self.background.requires_grad_()
            table["background"] = Rate(3e-2, 0.2)
        material = torch.logit(gaussians.position.new_tensor(kind.material))
        gaussians = replace(gaussians, material=material[:, None].repeat(1, gaussians.count))
        self.optimizer = GaussianOptimizer(gaussians, table, others)
        self._rates, self._set_iterations = table, settings.iterations
        self._start = gaussians.count
        self.density = DensityControl(settings.gaussians, dataset.bound.radius)
        self.done, self.order, self._loss = 0, torch.zeros(0, dtype=torch.long), math.nan

    def render(self, target: TrainingView, degree: int = 3):
        """The encoded image (3, H, W), the rasterised sums and the screen statistics."""
        g, radius = self.optimizer.gaussians, self.dataset.bound.radius
        extra = g.materials() if self.kind.glossy else g.position.new_zeros(0, g.count)
        sums, statistics = rasterize(g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra, target.camera, radius, degree)
        straight = radiance(sums, target.world_rays, self.light.exp() if self.kind.glossy else None)
        background = None if self.masked else self.background.exp()
        return composite(straight, sums[-1], target.world_rays, background), sums, statistics

    def step(self) -> float:
        """One view, one step; returns the loss, on a device that of the last step that was looked at."""
        target = self.targets[self._next_view()].to(self.device)
        image, sums, statistics = self.render(target, self._degree())
        loss = photometric_loss(target.bounded(image), target.image)
        if target.alpha is not None:
            loss = loss + self.settings.mask_weight * (sums[-1] - target.alpha).abs().mean()
        loss = loss + self.settings.normal_weight * normal_consistency(sums, target.rays, target.rotation)
        loss = loss * target.share  # all losses are means over the pixels; where an image was cut off they are 0
        if self.kind.glossy:
            loss = loss + self.settings.light_smoothness * _roughness_of(self.light)
        if due(loss, self.done + 1):
            self._loss = self._looked_at(loss)
        loss.backward()
        self.optimizer.step(self.done / self.settings.iterations)
        self.done += 1
        self._control(statistics)
        return self._loss

    def _looked_at(self, loss: torch.Tensor) -> float:
        value = loss.item()
        if not math.isfinite(value):
            self.optimizer.check_finite()  # names the parameter where it is one
            raise IrgsppError(f"the first stage's loss is not finite at iteration {self.done + 1}")
        return value

    def _degree(self) -> int:
        """SH degrees come one after the other, so that parallax is explained by geometry before it can be by view-dependent colour."""
        share = self.done / self.settings.iterations
        return 3 if share >= self.settings.sh_growth else int(3 * share / self.settings.sh_growth)

    def _control(self, statistics: ScreenStatistics) -> None:
        """Density control in the middle of the schedule; a hull start has its Gaussians where they belong and is only pruned."""
        settings, share = self.settings, self.done / self.settings.iterations
        if not 0.1 < share < 0.7:
            return
        self.density.observe(statistics)
        # A hull start needs every view looked at before something counts as unseen.
        period = max(settings.iterations // 20, 2 * len(self.targets) if self.masked else 1)
        if self.density.images >= period:
            self.density.refine(self.optimizer, self.generator, grow=not self.masked)
            self._check_hull()
        if not self.masked and self.done % RESET_EVERY == 0:
            reset_opacity(self.optimizer)

    def _check_hull(self) -> None:
        """Raise IrgsppError where most of a visual hull is gone: none of it grows back, and what is left is no object."""
        left = self.optimizer.gaussians.count
        if self.masked and left < HULL_LEFT * self._start:
            lost = f"only {left:,} of {self._start:,} surfels of the visual hull are left at iteration {self.done}"
            raise IrgsppError(f"{lost}; do cameras and masks fit the photographs?")

    def _next_view(self) -> int:
        if not len(self.order):
            order = torch.randperm(len(self.targets), generator=self.generator)
            self.order = order[~self.held_back[order]]
        view, self.order = int(self.order[-1]), self.order[:-1]
        return view

    def test(self) -> float | None:
        """Mean PSNR in dB over the held-back views, or None where there are none."""
        values = []
        for index in torch.nonzero(self.held_back)[:, 0].tolist():
            target = self.targets[index].to(self.device)
            with torch.no_grad():
                error = (self.render(target)[0].clamp(0, 1) - target.image).square().mean() * target.share
            values.append(-10 * math.log10(max(error.item(), 1e-10)))
        return sum(values) / len(values) if values else None

    def image(self) -> np.ndarray:
        """(H, W, 3) uint8: the first training view as it is now, small."""
        camera = self.targets[0].camera
        with torch.no_grad():
            small = make_training_view(self.dataset.train[0], math.ceil(max(camera.width, camera.height) / LONGEST))
            rendered = self.render(small.to(self.device))[0]
        return eight_bits(rendered.permute(1, 2, 0).cpu().numpy())

    def paced(self, iterations: int) -> None:
        """Go on with a schedule of another length.

        The gradients' noise moves surfels by their rate times the root of the steps: they go the slower the longer the schedule is, so that
        it scatters them no more than one of MEANT_FOR steps does, or the one that was set.
        """
        slower = math.sqrt(min(1.0, max(MEANT_FOR, self._set_iterations) / iterations))
        self.optimizer.rates = {name: rate.times(slower) if name in MOVES else rate for name, rate in self._rates.items()}
        self.settings = replace(self.settings, iterations=iterations)

    def run(self, progress: Progress, checkpoint: Checkpoint | None) -> None:
        """To the end of the schedule, or until the user is content; raises Cancelled after a checkpoint."""
        saved = time.monotonic()
        while self.done < self.settings.iterations and not progress.finish_early:
            if progress.cancelled:
                if checkpoint is not None:
                    checkpoint.save("first_stage", self.state())
                raise Cancelled(f"stopped at iteration {self.done} of the first stage")
            figures = {"loss": self.step()}
            if self.done % TEST_EVERY == 0 or self.done == self.settings.iterations:
                psnr = self.test()
                figures |= {} if psnr is None else {"psnr": psnr}
            progress.step(self.done, **figures)
            progress.image(self.image)
            if checkpoint is not None and time.monotonic() - saved > CHECKPOINT_SECONDS:
                checkpoint.save("first_stage", self.state())
                saved = time.monotonic()

    def state(self) -> dict[str, Any]:
        """Everything that the rest of the schedule depends on."""
        density = {"gradient": self.density.gradient, "seen": self.density.seen, "pictures": self.density.images}
        order = {"order": self.order, "generator": self.generator.get_state()}
        return {
            "done": self.done,
            "iterations": self.settings.iterations,
            "kind": self.kind.name,
            "optimizer": self.optimizer.state(),
            **density,
            **order,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state`. Raises InputError where it is no state of such a fit."""
        try:
            fits = self._fits(state)
        except (LookupError, TypeError, ValueError, AttributeError, RuntimeError):  # values of any kind, in any place
            fits = False
        if not fits:
            raise no_state()
        self.done, self.order = int(state["done"]), state["order"]
        self.paced(int(state["iterations"]))
        self.generator.set_state(state["generator"])
        self.density.gradient, self.density.seen = state["gradient"].to(self.device), state["seen"].to(self.device)
        self.density.images = int(state["pictures"])
        self.optimizer.restore(state["optimizer"])

    def _fits(self, state: dict[str, Any]) -> bool:
        """Whether `state` is one of a fit like this; what is wrong with it may also raise."""
        torch.Generator().set_state(state["generator"])
        order, gradient, seen = state["order"], state["gradient"], state["seen"]
        views = order.dtype == torch.long and order.ndim == 1 and bool(((order >= 0) & (order < len(self.targets))).all())
        statistics = gradient.dtype == seen.dtype == torch.float32 and gradient.shape == seen.shape == (len(seen),)
        counts = all(type(state[name]) is int for name in ("done", "iterations", "pictures"))
        schedule = counts and 0 <= state["done"] <= state["iterations"] and state["iterations"] > 0 and state["pictures"] >= 0
        return views and statistics and schedule and self.optimizer.fits(state["optimizer"])


def no_state() -> InputError:
    """What a checkpoint raises that is whole, but no state of such a fit."""
    return InputError("checkpoint/first_stage.pt", "holds no state of this job's first stage", "delete it, or start anew with --overwrite")


def border_radiance(targets: list[TrainingView]) -> torch.Tensor:
    """(3,) median linear colour along the images' borders: what the background is like before anything is known."""
    edges = [t.image[:, rows, columns].flatten(1) for t in targets for rows, columns in ((0, slice(None)), (slice(None), 0))]
    return decode_srgb(torch.cat(edges, 1).median(1).values).clamp_min(1e-3)


def _roughness_of(light: torch.Tensor) -> torch.Tensor:
    """Mean squared difference of neighbours of a log light map."""
    across = light - torch.roll(light, 1, 1)
    return across.square().mean() + (light[1:] - light[:-1]).square().mean()
