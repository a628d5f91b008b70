# SPDX-License-Identifier: GPL-3.0-or-later
"""Quick fit: few surfels fitted briefly to reduced images, for the outlines and colours on which all photographs agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ...errors import Cancelled
from ...io.srgb import encode_srgb
from ...kernels.rasterize import rasterize
from ...progress.protocol import Progress
from ...rendering.deferred import splat_radiance
from ...scene.dataset import Dataset
from ...settings.schema import Settings
from .initialization import initial_gaussians
from .material_class import LOW_GLOSS
from .trainer import Trainer

SURFELS, ITERATIONS = 10_000, 250  # of the fit
MAX_IMAGE_SIDE = 320  # longest side of the images, pixels


def quick_renderings(dataset: Dataset, settings: Settings, progress: Progress) -> list[tuple[np.ndarray, np.ndarray]]:
    """Fit surfels on the visual hull to the training views, and render them in all of these.

    The fit follows the masks: with bands at their edges its outlines would be .3 to .6 pixels wider, and the masks that are cut by them
    .1 pixels.

    Args:
        dataset: views with masks.
        settings: settings of the job.
        progress: receives the phase "quick fit", and may cancel.

    Returns:
        Of each training view the straight colour (H, W, 3) float32 sRGB-encoded, and the opacity (H, W) float32.

    Raises:
        Cancelled: the user stopped the work.
    """
    dataset = replace(dataset, train=[replace(view, mask_error=0.0) for view in dataset.train])
    torch.manual_seed(settings.seed)
    brief = replace(settings.first, iterations=ITERATIONS, gaussians=SURFELS)
    camera = dataset.train[0].camera
    reduction = max(1, round(max(camera.width, camera.height) / MAX_IMAGE_SIDE))
    start = initial_gaussians(dataset, SURFELS, np.random.default_rng(settings.seed))
    trainer = Trainer(dataset, brief, start, LOW_GLOSS, settings.seed, 0, reduction, crop=True)
    progress.phase("quick fit", ITERATIONS)
    while trainer.done < ITERATIONS:
        if progress.cancelled:
            raise Cancelled("stopped in the quick fit")
        progress.step(trainer.done + 1, loss=trainer.step())
    return _rendered(trainer, dataset, progress)


def _rendered(trainer: Trainer, dataset: Dataset, progress: Progress) -> list[tuple[np.ndarray, np.ndarray]]:
    """Render the fit at the size of the views."""
    g, result = trainer.optimizer.gaussians, []
    parameters = (g.position, g.quaternion, g.log_scale, g.opacity, g.sh, g.position.new_zeros(0, g.count))
    for view in dataset.train:
        if progress.cancelled:
            raise Cancelled("stopped in the quick fit")
        with torch.no_grad():
            sums, _ = rasterize(*parameters, view.camera, dataset.bound.radius, 3)
        result.append((encode_srgb(splat_radiance(sums)).permute(1, 2, 0).numpy(), sums[-1].numpy()))
    return result
