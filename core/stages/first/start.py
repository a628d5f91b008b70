# SPDX-License-Identifier: GPL-3.0-or-later
"""Start: the surfels that the first stage starts with, and what else is known of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ...scene.gaussians import Gaussians
from .depth_anchors import DepthAnchors


@dataclass(frozen=True, eq=False)
class Start:
    """What the first stage starts with.

    Attributes:
        gaussians: initial values.
        anchors: stereo's depths, where the surfels start on stereo's points and masks tell the object from its surroundings.
        metal: (N,) bool, surfels that start as metal; None for none.
    """

    gaussians: Gaussians
    anchors: DepthAnchors | None = None
    metal: torch.Tensor | None = None

    def points(self) -> np.ndarray:
        """Return the positions (N, 3) float64 of the surfels, world."""
        return self.gaussians.position.T.double().cpu().numpy()

    def normals(self) -> np.ndarray:
        """Return the normals (N, 3) float64 of the surfels, unit, outwards."""
        return self.gaussians.normals().T.double().cpu().numpy()
