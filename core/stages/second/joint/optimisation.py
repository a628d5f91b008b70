# SPDX-License-Identifier: GPL-3.0-or-later
"""Joint optimisation: gradient descent on geometry, radiance, materials and light, one view per iteration (IRGS++).

The learning rates are those of IRGS' second stage, constant over the schedule. IRGS freezes the geometry, IRGS++ optimises it too; the
setting `second.geometry_rate` scales Ref-Gaussian's rates of the geometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ....errors import InputError
from ....io.srgb import encode_srgb
from ....scene.camera import Camera
from ....scene.dataset import View
from ....scene.gaussians import Gaussians
from ....scene.reconstruction import Reconstruction
from ....settings.schema import SecondStageSettings
from ...common.finite_check import check_due, require_finite
from ...common.light_map import resized_light
from ...common.optimizer import GaussianOptimizer, Rate
from ...common.training_view import make_training_view
from ...common.view_order import next_view
from ..held_back import held_back
from ..refinement.refinement import MIN_RADIANCE, TEST_PIXELS, TEST_SAMPLES, split_samples
from .losses import LOW_GLOSS_WEIGHTS, NORMALS_FROM, Weights, joint_losses
from .model import JointModel

SAMPLE_FRACTIONS = (0.5, 0.25, 0.25)  # of cosine, visible-normal and light samples: 256, 128 and 128, or 8, 4 and 4
LEARNING_RATES = {"sh_dc": 7.5e-3, "sh_rest": 7.5e-3 / 20, "albedo": 7.5e-3, "roughness": 5e-3, "metallic": 5e-3, "light": 1e-2}  # of Adam
GEOMETRY_LEARNING_RATES = {  # of Adam; position: per unit of the cameras' extent
    "position": 1.6e-4,
    "quaternion": 1e-3,
    "log_scale": 5e-3,
    "opacity": 5e-2,
}
PUBLISHED_RATE_FACTOR = Rate(1.0)  # factor of the rates: constant over the schedule
EXTENT_RATIO = 1.1  # extent of the cameras over the largest distance of one from their mean (3DGS)
MIN_MASK_OPACITY = 0.99  # of the mask: pixels of a test show the object alone


class JointOptimisation:
    """State and step of the joint optimisation.

    Attributes:
        start: reconstruction at the start, whose SH hold all radiance.
        model: constants of rendering.
        settings: settings of the second stage; `iterations` is the length of this schedule.
        weights: weights of the losses.
        training_views: prepared photographs.
        held_back: (V,) bool, views that are tested and not trained on.
        optimizer: Gaussians and light.
        light: (H, 2H, 3) log radiance.
        counts: cosine, visible-normal and light samples per pixel.
        done: iterations done.
    """

    def __init__(
        self,
        start: Reconstruction,
        views: Sequence[View],
        model: JointModel,
        settings: SecondStageSettings,
        seed: int,
        *,
        weights: Weights = LOW_GLOSS_WEIGHTS,
        factor: Rate = PUBLISHED_RATE_FACTOR,
        hold_back: bool = False,
    ) -> None:
        """Prepare the photographs and the optimiser.

        Args:
            start: reconstruction whose SH hold all radiance.
            views: photographs.
            model: constants of rendering for this reconstruction.
            settings: settings of the second stage; `joint_iterations` becomes the length of the schedule.
            seed: seed of the order of views, the pixels and the samples.
            weights: weights of the losses.
            factor: factor of all learning rates, over the schedule.
            hold_back: do not train on the views of `held_back`.
        """
        self.start, self.model, self.settings = start, model, replace(settings, iterations=settings.joint_iterations)
        self.weights = weights
        self.device = start.gaussians.position.device
        self.training_views = [make_training_view(view, crop=view.alpha is not None).to(self.device) for view in views]
        every = held_back(len(views))
        self.held_back = every if hold_back else torch.zeros_like(every)
        self.tested = torch.nonzero(every if every.any() else ~every)[:, 0].tolist()
        self.light = resized_light(start.environment, settings.light_height).clamp_min(MIN_RADIANCE).log().contiguous().requires_grad_()
        rates = {name: Rate(rate) for name, rate in LEARNING_RATES.items() if name != "metallic" or settings.brdf != "irgs"}
        if settings.geometry_rate > 0:
            extent = camera_extent([view.camera for view in views])
            rates |= {name: Rate(settings.geometry_rate * rate) for name, rate in GEOMETRY_LEARNING_RATES.items()}
            rates["position"] = rates["position"].times(extent)
        rates = {name: Rate(factor.start * rate.start, factor.final) for name, rate in rates.items()}
        self.optimizer = GaussianOptimizer(start.gaussians, rates, {"light": self.light})
        self.counts = split_samples(settings.samples, SAMPLE_FRACTIONS)
        self.generator = torch.Generator().manual_seed(seed)
        self.done, self._order = 0, torch.zeros(0, dtype=torch.long)

    def run(self, report: Callable[[int, float], object] = lambda done, loss: None) -> None:
        """Do all iterations of the schedule.

        Args:
            report: called with the number of iterations done and the loss; it may raise, and ends the run early by returning True.

        Raises:
            IrgsppError: a value is not finite.
            InputError: no photograph shows the object.
        """
        while self.done < self.settings.iterations:
            loss = self.step()
            if report(self.done, loss):
                return

    def step(self) -> float:
        """Do one iteration on one view and return its loss; NaN on a GPU where the host did not read it."""
        loss, value = self.loss(), math.nan
        if check_due(loss, self.done + 1):
            if not loss.isfinite():
                self.optimizer.check_finite()  # names the parameter where it is one
            require_finite({"the joint optimisation's loss": loss}, f"at iteration {self.done + 1}")
            value = loss.item()
        loss.backward()
        self.optimizer.step(self.done / self.settings.iterations)
        self.done += 1
        return value

    def loss(self) -> torch.Tensor:
        """Compute the loss of the next view."""
        gaussians = self._gaussians()
        for _ in self.training_views:  # a view may show nothing of the object
            number, self._order = next_view(self._order, self.held_back, self.generator)
            view = self.training_views[number]
            sums = self.model.render(gaussians, view)
            shown = self.model.foreground(sums, view)
            if len(shown):
                break
        else:
            raise InputError("second.solver", "no photograph shows the object", "check that cameras and masks match the images")
        pixels = self._choose(shown, self.settings.pixels, self.generator)
        light, method = self.light.detach().exp(), self.settings.sampling
        plan = self.model.plan(sums, view, pixels, light, self.counts, self.generator, method)
        geometry = self.settings.geometry_rate > 0 and self.done >= NORMALS_FROM * self.settings.iterations
        losses = joint_losses(self.model, gaussians, self.light, sums, view, plan, self.weights, geometry)
        return torch.stack(list(losses.values())).sum()

    def reschedule(self, iterations: int) -> None:
        """Continue with a schedule of another length in iterations."""
        self.settings = replace(self.settings, iterations=iterations)

    def test(self) -> float:
        """Return the PSNR in dB of shaded pixels of the tested views, always with the same pixels and samples."""
        generator, light, errors = torch.Generator().manual_seed(0), self.light.detach().exp(), []
        share = max(1, TEST_PIXELS // len(self.tested))
        with torch.no_grad():
            for view in (self.training_views[number] for number in self.tested):
                sums = self.model.render(self._gaussians(), view)
                shown = self.model.foreground(sums, view)
                if view.alpha is not None:
                    shown = shown[view.alpha.flatten()[shown] > MIN_MASK_OPACITY]
                pixels = self._choose(shown, share, generator)
                if not len(pixels):
                    continue
                plan = self.model.plan(sums, view, pixels, light, TEST_SAMPLES, generator)
                colour = self.model.shade(self._gaussians(), light, sums, view, plan)[0].T
                difference = encode_srgb(colour.clamp_min(1e-5)) - view.image.flatten(1)[:, pixels]
                bound = view.saturated.flatten(1)[:, pixels]
                errors.append(torch.where(bound & (difference > 0), 0.0, difference).square().mean(0))
        return -10 * math.log10(max(float(torch.cat(errors).mean()), 1e-10)) if errors else -math.inf

    def result(self) -> Reconstruction:
        """Return the current reconstruction."""
        g = Gaussians(**{name: value.detach().clone() for name, value in self.optimizer.gaussians.tensors().items()})
        return replace(self.start, gaussians=g, environment=self.light.detach().exp(), confidence=None)

    def state(self) -> dict[str, Any]:
        """Return everything that the rest of the schedule depends on, for a checkpoint."""
        schedule = {"done": self.done, "iterations": self.settings.iterations}
        return schedule | {"order": self._order, "generator": self.generator.get_state(), "optimizer": self.optimizer.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a `state`; raise InputError where it is not one of this optimisation."""
        try:
            fits = self._fits(state)
        except (LookupError, TypeError, ValueError, AttributeError, RuntimeError):  # the file may hold any values
            fits = False
        if not fits:
            fix = "delete it, or start again with --overwrite"
            raise InputError("checkpoint/joint.pt", "holds no state of this job's joint optimisation", fix)
        self.done, self._order = int(state["done"]), state["order"]
        self.reschedule(int(state["iterations"]))
        self.generator.set_state(state["generator"])
        self.optimizer.restore(state["optimizer"])

    def _fits(self, state: dict[str, Any]) -> bool:
        """Return True where `state` is one of an optimisation like this; may raise on values of a wrong type."""
        torch.Generator().set_state(state["generator"])
        order, values = state["order"], state["optimizer"]
        views = order.dtype == torch.long and order.ndim == 1 and bool(((order >= 0) & (order < len(self.training_views))).all())
        schedule = all(type(state[name]) is int for name in ("done", "iterations")) and 0 <= state["done"] <= state["iterations"]
        count = values["values"]["position"].shape[1] == self.start.gaussians.count
        return views and schedule and state["iterations"] > 0 and count and self.optimizer.fits(values)

    def _gaussians(self) -> Gaussians:
        """Return the current Gaussians; gradients flow to what is optimised."""
        g = self.optimizer.gaussians
        if self.settings.geometry_rate > 0:
            return g
        return replace(g, **{name: getattr(g, name).detach() for name in GEOMETRY_LEARNING_RATES})

    @staticmethod
    def _choose(among: torch.Tensor, count: int, generator: torch.Generator) -> torch.Tensor:
        """Draw pixels without replacement, at most `count`, in ascending order."""
        chosen = torch.randperm(len(among), generator=generator)[:count].to(among.device)
        return among[chosen].sort().values


def camera_extent(cameras: Sequence[Camera]) -> float:
    """Return the extent of cameras as 3DGS measures it, world units."""
    centres = np.stack([camera.centre for camera in cameras])
    return EXTENT_RATIO * float(np.linalg.norm(centres - centres.mean(0), axis=1).max())
