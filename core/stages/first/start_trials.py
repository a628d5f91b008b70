# SPDX-License-Identifier: GPL-3.0-or-later
"""Trial fits of the first stage's possible starts. Each is made once, as several choices compare others with the same start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...settings.schema import Settings
from .layered_regions import layered_regions
from .material_class import MaterialClass
from .start import Start
from .trainer import Trainer
from .trial_fits import prepare_trial, report_trials, run_trials, with_finer_trials


@dataclass(frozen=True, eq=False)
class StartTrials:
    """Trial fits of an object from its possible starts, with closed edges.

    Attributes:
        dataset: views.
        settings: settings of the job.
        material_class: class of the object.
        crop: crop the images to the object.
        gloss_gain: see `SelectedClass`.
        fits: what has been fitted, by start.
        layered: regions in several layers, by the positions of a start's surfels.
    """

    dataset: Dataset
    settings: Settings
    material_class: MaterialClass
    crop: bool = False
    gloss_gain: float = 0.0
    fits: dict[Start, Trainer] = field(default_factory=dict)
    layered: dict[torch.Tensor, list[np.ndarray]] = field(default_factory=dict)

    def fit_of(self, start: Start) -> Trainer:
        """Return the trial fit of a start; `compare` runs it.

        Args:
            start: one of this object's.
        """
        if start not in self.fits:
            # Without masks the surroundings are fitted, too; more surfels and pixels would take long there.
            sized = with_finer_trials(self.settings) if self.dataset.has_alpha else self.settings
            closed = replace(sized, first=replace(sized.first, open_edges=0.0))
            self.fits[start] = prepare_trial(self.dataset, closed, start.gaussians, self.material_class, self.crop, start.metal)
        return self.fits[start]

    def layered_regions(self, start: Start) -> list[np.ndarray]:
        """Return the masks (N,) bool of the regions of a start whose points lie in several layers, the largest first.

        Args:
            start: one of this object's; starts with the same surfels have the same regions.
        """
        position = start.gaussians.position
        if position not in self.layered:
            self.layered[position] = layered_regions(start.points(), start.normals(), self.dataset.bound.radius)
        return self.layered[position]

    def compare(self, starts: Mapping[str, Start], progress: Progress, may_give_up: bool) -> dict[str, float]:
        """Run the trial fits of starts, as far as they have not been, and return their PSNR in dB on held-back views by name.

        Args:
            starts: by the name of what is tried.
            progress: receives steps, and may cancel.
            may_give_up: a fit that has fallen behind may be abandoned, by the skip rule "trials", which is reported.

        Raises:
            Cancelled: the user stopped the work.
        """
        fits = {name: self.fit_of(start) for name, start in starts.items()}
        settings = self.settings if may_give_up else replace(self.settings, skip=replace(self.settings.skip, trials="off"))
        score, given_up = run_trials(fits, settings, progress)
        if may_give_up and (given_up or not self.dataset.has_alpha):  # with masks, the trial fits of the classes have been reported
            report_trials(settings, given_up, progress)
        return score
