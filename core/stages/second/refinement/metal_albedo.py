# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo pooling of metal: the albedo of a metal part goes half way to the median of all metal of like tint.

The albedo of a metal is its observed over its expected reflection. Where normals, light or mirrored neighbours are a little wrong, it
holds a picture of the surroundings, bright on one side of a part and dark on the other. Views on that side agree about it, so that
no photograph tells; but it is wrong under any other light. A metal's reflectance varies little: it is that of the bare material.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ....scene.gaussians import ALBEDO, METALLIC, Gaussians
from ....scene.reconstruction import Reconstruction
from ..metal import DARKEST, METALLIC_THRESHOLD, TINT_WIDTH, tints

# Part of the way to the median, in logarithms. Albedo, relit images and new views change by, in dB: rocker_corner +.6, -.0, -.3,
# suzanne_mixed +.3, +.0, +.0, a padlock +.7, +.3, -.1, capture_ogre +.4, +.1, -.0. The whole way brings 1.3, .5 and 1.8 dB of albedo on
# the first three, and costs .6, .0 and .4 dB of new views.
POOLED_SHARE = 0.5
MAX_SOURCES = 1000  # surfels of metal, drawn at random, of which the medians are taken
BATCH = 1024  # surfels at a time
LOGIT_MARGIN = 2e-3  # albedo is kept this far inside 0..1, so that its logit is finite


def with_pooled_metal_albedo(reconstruction: Reconstruction, seed: int) -> Reconstruction:
    """Return a reconstruction in which the albedo of metal is pooled; the same where there is no metal.

    Args:
        reconstruction: N surfels.
        seed: seed of the random choice of the surfels of which the medians are taken.
    """
    gaussians = reconstruction.gaussians
    metal = torch.nonzero(gaussians.materials().detach()[METALLIC] > METALLIC_THRESHOLD)[:, 0]
    if not len(metal):
        return reconstruction
    material = gaussians.material.clone()
    material[ALBEDO, metal] = torch.logit(_pooled(gaussians, metal, seed)).to(material)
    return replace(reconstruction, gaussians=replace(gaussians, material=material))


def _pooled(gaussians: Gaussians, metal: torch.Tensor, seed: int) -> torch.Tensor:
    """Return the pooled albedo (3, M) of the surfels `metal` (M,)."""
    log = gaussians.materials().detach()[ALBEDO][:, metal].cpu().clamp_min(DARKEST).log()
    sources = torch.randperm(len(metal), generator=torch.Generator().manual_seed(seed))[:MAX_SOURCES]
    medians = tint_weighted_medians(log.T.numpy(), log.T[sources].numpy())
    pooled = torch.lerp(log, torch.from_numpy(medians.T.copy()), POOLED_SHARE)
    return pooled.exp().clamp(LOGIT_MARGIN, 1 - LOGIT_MARGIN)


def tint_weighted_medians(log: np.ndarray, sources: np.ndarray) -> np.ndarray:
    """Compute medians of sources, weighted by how much their tint is like that of each point.

    Args:
        log: (M, 3) log albedo of the points.
        sources: (S, 3) log albedo of the sources.

    Returns:
        (M, 3) log albedo; each channel has its own median.
    """
    own, others = tints(torch.from_numpy(log)), tints(torch.from_numpy(sources))
    order, medians = sources.argsort(0, kind="stable"), np.empty_like(log)
    for begin in range(0, len(log), BATCH):
        part = slice(begin, begin + BATCH)
        weight = torch.exp(-0.5 * (torch.cdist(own[part], others) / TINT_WIDTH) ** 2).numpy()
        for channel in range(3):
            ranked = order[:, channel]
            below = weight[:, ranked].cumsum(1)
            middle = (below < 0.5 * below[:, -1:]).sum(1).clip(max=len(ranked) - 1)
            medians[part, channel] = sources[ranked[middle], channel]
    return medians
