# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of finished phases, read back from the run folder as input of the next phase."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch

from ..errors import InputError
from ..run_folder import RunFolder
from ..scene.dataset import Dataset, View
from ..scene.reconstruction import Reconstruction
from ..scene.surface import Surface

FIRST_STAGE = Path("checkpoint", "first")  # in the run folder: result of the first stage, until the job is done
MASKS = "masks"  # checkpoint of the masks that were cut again
GEOMETRY = "geometry"  # checkpoint of the surface without textures
UNWRAP = Path("checkpoint", "unwrap")  # in the run folder: files of the process that unwraps the surface, beside the second stage


class PhaseResults:
    """Results of finished phases.

    They are read from the disk even right after a phase wrote them, so that an uninterrupted run and a resumed one compute from
    exactly the same numbers.
    """

    def __init__(self, folder: RunFolder, device: torch.device) -> None:
        self._folder, self.device = folder, device

    def with_masks(self, dataset: Dataset) -> Dataset:
        """Return a dataset whose training views have the masks that were cut again, with their error; raise InputError without them."""
        masks = self._folder.load(MASKS, lambda state: _masks(dataset, state))
        if masks is None:
            raise InputError(self._folder.path / "checkpoint", f"has no {MASKS}.pt", "start again with --overwrite")
        return replace(dataset, train=masks)

    @cached_property
    def first_stage(self) -> Reconstruction:
        """Reconstruction of the first stage, on the device."""
        return Reconstruction.load(self._folder.path / FIRST_STAGE).to(self.device)

    @cached_property
    def surface(self) -> Surface:
        """Surface without textures; raises InputError where its checkpoint is gone."""
        surface = self._folder.load(GEOMETRY, Surface.restored)
        if surface is None:
            raise InputError(self._folder.path / "checkpoint", f"has no {GEOMETRY}.pt", "start again with --overwrite")
        return surface

    @cached_property
    def reconstruction(self) -> Reconstruction:
        """Reconstruction of both stages, on the device."""
        return Reconstruction.load(self._folder.path).to(self.device)


def _masks(dataset: Dataset, state: dict[str, Any]) -> list[View]:
    """Return the training views with the masks of a checkpoint; raise ValueError where they don't fit."""
    views = []
    for view in dataset.train:
        alpha, error, cut = state[view.name]
        if alpha.shape != view.colour.shape[:2]:
            raise ValueError(f"mask of {view.name}")
        views.append(replace(view, alpha=alpha.numpy(), mask_error=float(error), cut_by_colours=bool(cut)))
    return views
