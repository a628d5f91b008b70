# SPDX-License-Identifier: GPL-3.0-or-later
"""Schedule of the first stage: what a step renders and how its losses are weighted, by the number of steps done."""

from __future__ import annotations

import math

from ...settings.schema import FirstStageSettings
from ..common.image_loss import LossWeights

ANCHORS_FROM = 0.3  # of the schedule: surfels have found the places that the photographs alone lead them to
RENEWALS = 10  # of the traced inter-reflections in a whole schedule: surfels move little between two of them
OPEN_EDGE_DISAGREEMENT = 0.2  # disagreement of normals, 1 - cosine, that counts half while edges are open: about 37 degrees


def sh_degree(settings: FirstStageSettings, done: int) -> int:
    """Return the highest SH degree in use, 0..3: degrees are added over time, so that geometry explains parallax before SH can."""
    fraction = done / settings.iterations
    return 3 if fraction >= settings.sh_growth else int(3 * fraction / settings.sh_growth)


def rays_per_side(settings: FirstStageSettings, done: int) -> int:
    """Return the rays along each side of a pixel: one where surfels still find their places; smooth outlines matter at the end."""
    return 1 if done < settings.single_rays * settings.iterations else settings.subpixels


def loss_weights(settings: FirstStageSettings, done: int) -> LossWeights:
    """Return the weights of the losses.

    Normal consistency in full fills corners and gaps between parts, where the depth's normals are a mean of both sides. While edges are
    open they stay free, but reflections then roughen metal parts, so that trial fits decide (`select_open_edges`).
    """
    edge = OPEN_EDGE_DISAGREEMENT if done < (settings.open_edges or 0.0) * settings.iterations else math.inf
    return LossWeights(settings.mask_weight, settings.normal_weight, edge, settings.distortion_weight)


def anchors_due(settings: FirstStageSettings, done: int) -> bool:
    """Return True from the step on at which depth anchors are chosen, where they count at all."""
    return settings.anchor_weight > 0 and done >= ANCHORS_FROM * settings.iterations


def densifies(settings: FirstStageSettings, masked: bool) -> bool:
    """Return True where density control adds Gaussians: a visual hull needs none, sparse points do.

    Args:
        settings: of the first stage.
        masked: all photographs have masks.
    """
    return settings.densification == "on" or (settings.densification == "auto" and not masked)


def inter_reflections_due(settings: FirstStageSettings, done: int) -> bool:
    """Return True at the steps at which inter-reflections are traced anew; never where the setting is None."""
    first = 1.0 if settings.inter_reflections is None else settings.inter_reflections
    since = done - math.ceil(first * settings.iterations)
    return first < 1 and since >= 0 and since % math.ceil(settings.iterations / RENEWALS) == 0
