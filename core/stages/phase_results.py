# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of finished phases, read back from the run folder as input of the next phase."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import torch

from ..errors import InputError
from ..run_folder import RunFolder
from ..scene.reconstruction import Reconstruction
from ..scene.surface import Surface

FIRST_STAGE = Path("checkpoint", "first")  # in the run folder: result of the first stage, until the job is done
GEOMETRY = "geometry"  # checkpoint of the surface without textures


class PhaseResults:
    """Results of finished phases.

    They are read from the disk even right after a phase wrote them, so that an uninterrupted run and a resumed one compute from
    exactly the same numbers.
    """

    def __init__(self, folder: RunFolder, device: torch.device) -> None:
        self._folder, self.device = folder, device

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
