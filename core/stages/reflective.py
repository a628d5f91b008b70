# SPDX-License-Identifier: GPL-3.0-or-later
"""The first stage: 2D Gaussians, their radiance and, where the object is glossy, reflections of a split-sum light."""

from __future__ import annotations

import numpy as np
import torch

from ..config import Settings
from ..datasets.dataset import Dataset
from ..progress import Checkpoint, Progress, Silent
from ..scene.reconstruction import Reconstruction
from ..skipping import decide
from .appearance import separate_light
from .hull import initial_gaussians
from .target import object_box
from .trainer import Trainer
from .trials import HOLD_BACK_FROM, choose_kind, kind_named

CUT_BELOW = 0.9  # share of the pictures around the object from which cutting them pays


def surroundings(dataset: Dataset, settings: Settings, progress: Progress) -> bool:
    """True where pictures are to be cut to the object: what is black in photograph and rendering teaches nothing."""
    shares = [1.0]
    if dataset.has_alpha:
        alphas = [torch.from_numpy(view.alpha) for view in dataset.train if view.alpha is not None]
        shares = [alpha[object_box(alpha)].numel() / alpha.numel() for alpha in alphas]
    share = float(np.mean(shares))
    evidence = f"the object's surroundings are {1 - share:.0%} of the pixels" if dataset.has_alpha else "without masks all pixels count"
    return decide(settings.skip, "outside", share < CUT_BELOW, evidence, progress) and dataset.has_alpha


def train(dataset: Dataset, settings: Settings, progress: Progress | None = None, checkpoint: Checkpoint | None = None) -> Reconstruction:
    """Fit Gaussians to the training views.

    Goes on from the checkpoint "reflective" where there is one; the result is then that of an undisturbed run.

    Raises:
        Cancelled: the user stopped the work; the checkpoint is written. IrgsppError: the loss is not finite, or no Gaussian is left.
    """
    progress = progress or Silent()
    torch.manual_seed(settings.seed)
    gaussians = initial_gaussians(dataset, settings.reflective.gaussians, np.random.default_rng(settings.seed))
    state = checkpoint.load("reflective") if checkpoint is not None else None
    cut = surroundings(dataset, settings, progress)
    kind = kind_named(state["kind"], dataset) if state is not None else choose_kind(dataset, settings, gaussians, progress, cut)
    hold_back = len(dataset.train) if len(dataset.train) >= HOLD_BACK_FROM else 0  # one view
    trainer = Trainer(dataset, settings.reflective, gaussians, kind, settings.seed, hold_back, cut=cut)
    if state is not None:
        trainer.restore(state)
    progress.phase("reflective", settings.reflective.iterations)
    trainer.run(progress, checkpoint)
    fitted = trainer.optimizer.gaussians.select(torch.arange(trainer.optimizer.gaussians.count))
    background = None if trainer.masked else trainer.background.detach().exp()
    result = Reconstruction(fitted, trainer.light.detach().exp(), dataset.bound, dataset.to_world, kind.glossy, background)
    return separate_light(result, settings.seed)
