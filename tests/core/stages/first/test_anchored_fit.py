# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth anchors in the first stage's optimisation."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import torch
from irgspp.core.scene.dataset import Dataset
from irgspp.core.settings.schema import FirstStageSettings
from irgspp.core.stages.first.depth_anchors import COMPARED_VIEWS, DepthAnchors
from irgspp.core.stages.first.depth_evidence import rendered_depths
from irgspp.core.stages.first.initialization import initial_gaussians
from irgspp.core.stages.first.material_class import LOW_GLOSS
from irgspp.core.stages.first.trainer import Trainer

SMALL = FirstStageSettings(iterations=12, gaussians=400, light_height=16, anchor_weight=5.0)


def anchors_in_front(dataset: Dataset, trainer: Trainer) -> DepthAnchors:
    """Anchors a little in front of a trainer's surfels, at every pixel that they cover."""
    depths = rendered_depths(trainer.optimizer.gaussians, trainer.dataset)
    pixels = [np.flatnonzero(depth > 0) for depth in depths]
    depth = np.concatenate([0.97 * one.reshape(-1)[pixel] for one, pixel in zip(depths, pixels, strict=True)])
    begin = torch.from_numpy(np.cumsum([0, *(len(pixel) for pixel in pixels)]))
    pixel = torch.from_numpy(np.concatenate(pixels).astype(np.int32))
    return DepthAnchors(begin, pixel, torch.from_numpy(depth), torch.full((len(dataset.train), COMPARED_VIEWS), -1), chosen=True)


def mean_depth(trainer: Trainer) -> float:
    """Mean depth of a trainer's surfels at the pixels that they cover."""
    depths = rendered_depths(trainer.optimizer.gaussians, trainer.dataset)
    return float(np.concatenate([depth[depth > 0] for depth in depths]).mean())


def test_anchors_pull_the_surfels_and_are_part_of_the_state(sphere_dataset, camera_ring):
    dataset, chosen = sphere_dataset(camera_ring(9, 32)), SMALL
    start = initial_gaussians(dataset, 400, np.random.default_rng(0))
    fit = (dataset, chosen, start, LOW_GLOSS, 0, 0)
    free, resumed = Trainer(*fit), Trainer(*fit)
    held = Trainer(*fit, anchors=anchors_in_front(dataset, free))
    before = mean_depth(free)
    for _ in range(6):
        held.step()
    resumed.restore(deepcopy(held.state()))
    for _ in range(6):
        held.step()
        resumed.step()
        free.step()
    assert torch.equal(held.optimizer.gaussians.position, resumed.optimizer.gaussians.position)
    depth_held, depth_free = mean_depth(held), mean_depth(free)
    assert depth_held < depth_free - 0.002 * before


def test_anchors_are_chosen_once_when_they_are_due(sphere_dataset, camera_ring, monkeypatch):
    dataset, chosen, steps = sphere_dataset(camera_ring(9, 32)), replace(SMALL, iterations=10), []
    trainer = Trainer(dataset, chosen, initial_gaussians(dataset, 400, np.random.default_rng(0)), LOW_GLOSS, 0, 0)
    trainer.anchors = replace(anchors_in_front(dataset, trainer), chosen=False)
    original = DepthAnchors.choose
    monkeypatch.setattr(DepthAnchors, "choose", lambda *a: steps.append(trainer.done) or original(*a))
    for _ in range(10):
        trainer.step()
    assert steps == [3]
