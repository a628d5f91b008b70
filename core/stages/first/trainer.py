# SPDX-License-Identifier: GPL-3.0-or-later
"""Optimisation loop of the first stage: one view per step, with density control."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import torch

from ...errors import Cancelled, IrgsppError
from ...io.quantisation import eight_bits
from ...kernels.rasterize import ScreenStatistics, rasterize
from ...progress.protocol import Checkpoint, Progress
from ...rendering.deferred import radiance
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...scene.reconstruction import Reconstruction
from ...settings.schema import FirstStageSettings
from ..common.depth_distortion import depth_moments
from ..common.finite_check import check_due
from ..common.image_loss import displayed, image_loss
from ..common.light_map import light_variation
from ..common.optimizer import GaussianOptimizer, Rate
from ..common.preview import MAX_IMAGE_SIDE, points_shape
from ..common.training_view import TrainingView, border_radiance, make_training_view
from ..common.training_view_cache import TrainingViewCache
from ..common.view_order import next_view
from .checkpoint_state import invalid_checkpoint, state_fits
from .densification import DensityControl, require_surfels, reset_opacity
from .depth_anchors import DepthAnchors
from .depth_evidence import rendered_depths
from .inter_reflections import InterReflections, traced_from
from .material_class import GEOMETRY_RATES, MaterialClass, initial_materials
from .schedule import anchors_due, densifies, inter_reflections_due, loss_weights, rays_per_side, sh_degree

START_RADIANCE = 0.5  # of the initial light map, linear
CHECKPOINT_SECONDS = 30.0  # between two checkpoints
DENSITY_CONTROL_RANGE = 0.1, 0.7  # fractions of the schedule between which density control acts
MAX_DENSITY_CONTROLS = 20  # it acts at most once in each such part of the schedule
RESET_EVERY = 3000  # steps between opacity resets (3DGS); shorter schedules have none
RATES_CHOSEN_AT = 1500  # steps of the schedule with which the GEOMETRY_RATES were chosen
TEST_EVERY = 50  # steps between tests on the held-back views
Rendered: TypeAlias = tuple[torch.Tensor, torch.Tensor, ScreenStatistics]  # image (3, H, W), sums (C, H, W), statistics


class Trainer:
    """State and step of the first stage's optimisation; `run` continues it to the end of its schedule.

    Attributes:
        training_views: prepared images of the dataset's training views.
        held_back: (V,) bool, views that are tested and not trained on.
        optimizer: Gaussians, and light and background maps where they are optimised.
        light: (H, 2H, 3) log radiance of the light map.
        background: (64, 128, 3) log radiance of the background map.
        masked: all images have masks; otherwise the background is optimised.
        done: steps done.
        order: views of the current epoch that are still to come, last first.
        anchors: stereo's depths at which the surfels' are held; None for none.
        inter_reflections: what mirrored rays meet; None where they are not traced yet, or never.
    """

    def __init__(
        self,
        dataset: Dataset,
        settings: FirstStageSettings,
        gaussians: Gaussians,
        material_class: MaterialClass,
        seed: int,
        hold_back: int,
        reduction: int = 1,
        crop: bool = False,
        resident: bool = True,
        anchors: DepthAnchors | None = None,
        metal: torch.Tensor | None = None,
    ) -> None:
        """Prepare the images and the optimiser.

        Args:
            dataset: views.
            settings: schedule and weights.
            gaussians: initial Gaussians, on the device to compute on; their materials are replaced by those of the material class.
            material_class: initial materials, learning rates, and whether reflections are rendered.
            seed: seed of the order of views and of density control.
            hold_back: one of so many views is held back for `test`; 0 for none.
            reduction: factor by which the images are reduced, see `make_training_view`.
            crop: crop the images, see `make_training_view`.
            resident: keep the images on the Gaussians' device; otherwise each is copied there for its step.
            anchors: stereo's depths, of which some are chosen in the course of the schedule; None for none.
            metal: (N,) bool, surfels that start with the materials of METAL instead; None for none.
        """
        self.anchors, self.inter_reflections = anchors, None
        settings = replace(settings, inter_reflections=traced_from(settings, material_class, dataset))
        self.dataset, self.settings, self.material_class = dataset, settings, material_class
        views = torch.arange(len(dataset.train))
        self.held_back = views % hold_back == hold_back // 2 if hold_back else views < 0
        self.device = gaussians.position.device
        self.training_views = TrainingViewCache(dataset.train, reduction, crop, self.device if resident else "cpu")
        self.generator = torch.Generator().manual_seed(seed)
        self.masked = dataset.has_alpha
        self.light = gaussians.position.new_full((settings.light_height, 2 * settings.light_height, 3), math.log(START_RADIANCE))
        self.background = border_radiance(self.training_views).log().expand(64, 128, 3).clone().to(self.device)
        others, table = {}, material_class.rates(dataset.bound.radius)
        if material_class.split_sum:
            others["light"] = self.light.requires_grad_()
        if not self.masked:
            others["background"] = self.background.requires_grad_()
            table["background"] = Rate(3e-2, 0.2)
        self.optimizer = GaussianOptimizer(replace(gaussians, material=initial_materials(gaussians, material_class, metal)), table, others)
        self._rates, self._configured_iterations, self._initial_count = table, settings.iterations, gaussians.count
        self.density = DensityControl(settings.gaussians, dataset.bound.radius)
        self.done, self.order, self._loss = 0, torch.zeros(0, dtype=torch.long), math.nan

    def render(self, view: TrainingView, degree: int = 3, mirrored: torch.Tensor | None = None) -> Rendered:
        """Render a view of the current Gaussians.

        Args:
            view: camera and rays.
            degree: highest SH degree in use, 0..3.
            mirrored: (4, H, W) what mirrored rays meet, see `InterReflections`; None: nothing.

        Returns:
            The sRGB-encoded image (3, H, W), the sums (C, H, W) of `rasterize`, and its screen-space statistics.
        """
        straight, sums, statistics = self._shade(view, degree, self.settings.subpixels, mirrored)
        return displayed(straight, sums[-1], view, self._background()), sums, statistics

    def _background(self) -> torch.Tensor | None:
        """Return the radiance of the background map, (64, 128, 3); None where all images have masks."""
        return None if self.masked else self.background.exp()

    def _shade(self, view: TrainingView, degree: int, subpixels: int, mirrored: torch.Tensor | None) -> Rendered:
        """Return the linear radiance (3, H, W) of a view with straight alpha, and the sums and the statistics of `rasterize`."""
        g, radius = self.optimizer.gaussians, self.dataset.bound.radius
        extra = g.materials() if self.material_class.split_sum else g.position.new_zeros(0, g.count)
        if self.settings.distortion_weight > 0:
            extra = torch.cat([extra, depth_moments(g, view.camera, self.dataset.bound.centre, radius)])
        parameters = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh, extra)
        sums, statistics = rasterize(*parameters, view.camera, radius, degree, subpixels)
        light = self.light.exp() if self.material_class.split_sum else None
        return radiance(sums, view.world_rays, light, view.light_rotation, mirrored), sums, statistics

    def step(self) -> float:
        """Do one step on one view and return its loss; on a GPU, that of the last step at which the host read it."""
        if self.anchors is not None and anchors_due(self.settings, self.done) and not self.anchors.chosen:
            self.anchors = self.anchors.choose(self.dataset, rendered_depths(self.optimizer.gaussians, self.dataset))
        if inter_reflections_due(self.settings, self.done):
            self.inter_reflections = InterReflections(self.reconstruction(), self.training_views)
        index = self._next_view()
        view = self.training_views[index].to(self.device)
        degree = sh_degree(self.settings, self.done)
        straight, sums, statistics = self._shade(view, degree, rays_per_side(self.settings, self.done), self._mirrored(index))
        loss = image_loss(straight, sums, view, self._background(), loss_weights(self.settings, self.done))
        if self.material_class.split_sum:
            loss = loss + self.settings.light_smoothness * light_variation(self.light)
        if self.anchors is not None and self.anchors.chosen:
            full = self.dataset.train[index].camera
            loss = loss + self.settings.anchor_weight * self.anchors.loss(index, sums, view.camera, full)
        if check_due(loss, self.done + 1):
            self._loss = self._finite_value(loss)
        loss.backward()
        self.optimizer.step(self.done / self.settings.iterations, (degree + 1) ** 2)
        self.done += 1
        self._control(statistics)
        return self._loss

    def _mirrored(self, index: int) -> torch.Tensor | None:
        """Return what the mirrored rays of a training view meet, (4, H, W); None where they are not traced."""
        return None if self.inter_reflections is None else self.inter_reflections[index]

    def reconstruction(self) -> Reconstruction:
        """Return a copy of the current state; raise IrgsppError where a value is not finite."""
        self.optimizer.check_finite()
        dataset, fitted = self.dataset, self.optimizer.gaussians.select(torch.arange(self.optimizer.gaussians.count))
        background = None if self.masked else self.background.detach().exp()
        light, has_split_sum = self.light.detach().exp(), self.material_class.split_sum
        return Reconstruction(fitted, light, dataset.bound, dataset.to_world, has_split_sum, background)

    def _finite_value(self, loss: torch.Tensor) -> float:
        """Read a loss (scalar); raise IrgsppError where it is not finite."""
        value = loss.item()
        if not math.isfinite(value):
            self.optimizer.check_finite()  # names the parameter where it is one
            raise IrgsppError(f"the first stage's loss is not finite at iteration {self.done + 1}")
        return value

    def _control(self, statistics: ScreenStatistics) -> None:
        """Apply density control in the middle of the schedule; where it does not densify, Gaussians are only pruned."""
        settings, fraction = self.settings, self.done / self.settings.iterations
        if not DENSITY_CONTROL_RANGE[0] < fraction < DENSITY_CONTROL_RANGE[1]:
            return
        self.density.accumulate(statistics)
        # With masks, every view must have been rendered before a Gaussian counts as unseen.
        period = max(settings.iterations // MAX_DENSITY_CONTROLS, 2 * len(self.training_views) if self.masked else 1)
        if self.density.images >= period:
            grows = densifies(settings, self.masked)
            self.density.refine(self.optimizer, self.generator, grow=grows)
            if not grows:
                require_surfels(self.optimizer.gaussians.count, self._initial_count, self.done)
        if not self.masked and self.done % RESET_EVERY == 0:
            reset_opacity(self.optimizer)

    def _next_view(self) -> int:
        """Draw a training view; each is drawn once per epoch."""
        view, self.order = next_view(self.order, self.held_back, self.generator)
        return view

    def test(self) -> float | None:
        """Return the mean PSNR in dB over the held-back views, None where there are none."""
        values = []
        for index in torch.nonzero(self.held_back)[:, 0].tolist():
            view = self.training_views[index].to(self.device)
            with torch.no_grad():
                error = (
                    self.render(view, mirrored=self._mirrored(index))[0].clamp(0, 1) - view.image
                ).square().mean() * view.pixel_fraction
            values.append(-10 * math.log10(max(error.item(), 1e-10)))
        return sum(values) / len(values) if values else None

    def image(self) -> np.ndarray:
        """Render the first training view as a small preview image (H, W, 3) uint8."""
        camera = self.training_views[0].camera
        with torch.no_grad():
            reduction = math.ceil(max(camera.width, camera.height) / MAX_IMAGE_SIDE)
            small = make_training_view(self.dataset.train[0], reduction).to(self.device)
            mirrored = None if self.inter_reflections is None else self.inter_reflections.along(small)
            rendered = self.render(small, mirrored=mirrored)[0]
        return eight_bits(rendered.permute(1, 2, 0).cpu().numpy())

    def reschedule(self, iterations: int) -> None:
        """Continue with a schedule of another length in steps.

        Gradient noise displaces surfels by their learning rate times the square root of the number of steps. The GEOMETRY_RATES of a
        longer schedule are lowered, so that it displaces them no more than RATES_CHOSEN_AT steps, or the steps in the settings, do.
        """
        slower = math.sqrt(min(1.0, max(RATES_CHOSEN_AT, self._configured_iterations) / iterations))
        self.optimizer.rates = {name: rate.times(slower) if name in GEOMETRY_RATES else rate for name, rate in self._rates.items()}
        self.settings = replace(self.settings, iterations=iterations)

    def run(self, progress: Progress, checkpoint: Checkpoint | None) -> None:
        """Step to the end of the schedule, or until the user asks to finish early.

        Args:
            progress: receives steps, metrics and previews.
            checkpoint: storage of the state, written every CHECKPOINT_SECONDS and on cancelling; None for none.

        Raises:
            Cancelled: the user stopped the work; the checkpoint is written.
            IrgsppError: a value is not finite, or too few Gaussians are left.
        """
        saved = time.monotonic()
        while self.done < self.settings.iterations and not progress.finish_early:
            if progress.cancelled:
                if checkpoint is not None:
                    checkpoint.save("first_stage", self.state())
                raise Cancelled(f"stopped at iteration {self.done} of the first stage")
            metrics = {"loss": self.step()}
            if self.done % TEST_EVERY == 0 or self.done == self.settings.iterations:
                psnr = self.test()
                metrics |= {} if psnr is None else {"psnr": psnr}
            progress.step(self.done, **metrics)
            progress.image(self.image)
            progress.shape(lambda: points_shape(self.optimizer.gaussians, self.dataset))
            if checkpoint is not None and time.monotonic() - saved > CHECKPOINT_SECONDS:
                checkpoint.save("first_stage", self.state())
                saved = time.monotonic()

    def state(self) -> dict[str, Any]:
        """Return everything that the rest of the schedule depends on, for a checkpoint."""
        density = {"gradient": self.density.gradient, "seen": self.density.seen, "pictures": self.density.images}
        order = {"order": self.order, "generator": self.generator.get_state()}
        schedule = {"done": self.done, "iterations": self.settings.iterations, "kind": self.material_class.name}
        anchors = None if self.anchors is None else self.anchors.state()
        schedule["open_edges"] = self.settings.open_edges or 0.0
        reflected = None if self.inter_reflections is None else self.inter_reflections.state()
        return {**schedule, "optimizer": self.optimizer.state(), "anchors": anchors, "inter_reflections": reflected, **density, **order}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a `state`; raise InputError where it is not one of this job's first stage."""
        try:
            fits = state_fits(state, len(self.training_views), self.optimizer)
            anchors = None if state["anchors"] is None else DepthAnchors.of_state(state["anchors"], self.dataset)
            reflected = state["inter_reflections"]
            if reflected is not None:
                reflected = InterReflections.of_state(reflected, self.reconstruction(), self.training_views)
        except (LookupError, TypeError, ValueError, AttributeError, RuntimeError):  # the file may hold any values
            fits, anchors, reflected = False, None, None
        if not fits:
            raise invalid_checkpoint()
        self.done, self.order, self.anchors, self.inter_reflections = int(state["done"]), state["order"], anchors, reflected
        self.settings = replace(self.settings, open_edges=float(state["open_edges"]))
        self.reschedule(int(state["iterations"]))
        self.generator.set_state(state["generator"])
        self.density.gradient, self.density.seen = state["gradient"].to(self.device), state["seen"].to(self.device)
        self.density.images = int(state["pictures"])
        self.optimizer.restore(state["optimizer"])
