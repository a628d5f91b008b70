# SPDX-License-Identifier: GPL-3.0-or-later
"""Roughness pooling: where the photographs say little about the roughness of a place, it takes that of well-known places like it nearby.

How well a place is known is its confidence. Metal takes from metal only, and the rest from the rest. Places of like albedo count more than
others; where there are none of like albedo, others are taken.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ....scene.gaussians import ALBEDO, METALLIC, ROUGHNESS, Gaussians
from ....scene.reconstruction import Reconstruction
from ...common.nearest_neighbours import nearest_neighbours
from ..metal import METALLIC_THRESHOLD

MAX_SOURCES = 5000  # surfels, drawn at random, whose roughness others may take
NEAREST_SOURCES = 128  # of them around a surfel: some 3 per cent of the surface
BATCH = 4096  # surfels at a time
CONFIDENCE_POWER = 6.0  # of the confidence, in the weight of a roughness
OWN_WEIGHT = 8.0  # factor of a surfel's own weight
ALBEDO_DECAY = 4.0  # exponential decay of the weight with the difference of albedos, summed over the colours
LOGIT_MARGIN = 2e-3  # roughness is kept this far inside 0..1, so that its logit is finite


def with_pooled_roughness(reconstruction: Reconstruction, seed: int) -> Reconstruction:
    """Return a reconstruction whose roughness is pooled by its confidence; the same where the confidence is not known.

    Args:
        reconstruction: N surfels with the confidence of their materials.
        seed: seed of the random choice of sources.
    """
    if reconstruction.confidence is None:
        return reconstruction
    gaussians, confidence = reconstruction.gaussians, reconstruction.confidence[1].cpu().numpy()
    roughness = pooled_roughness(gaussians, confidence, np.random.default_rng(seed))
    material = gaussians.material.clone()
    material[ROUGHNESS] = torch.logit(torch.from_numpy(roughness.clip(LOGIT_MARGIN, 1 - LOGIT_MARGIN))).to(material)
    return replace(reconstruction, gaussians=replace(gaussians, material=material))


def pooled_roughness(gaussians: Gaussians, confidence: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Compute the roughness (N,) of all surfels: means of their own and of the sources' around them, by confidence.

    Args:
        gaussians: N surfels.
        confidence: (N,) of their roughness, in 0..1.
        random: random generator of the choice of sources.
    """
    position, materials = gaussians.position.T, gaussians.materials().detach().cpu().numpy()
    sources = random.permutation(len(position))[:MAX_SOURCES]
    around = sources[nearest_neighbours(position[sources], position, NEAREST_SOURCES).cpu().numpy()]
    known = np.maximum(confidence, 1e-6).astype(np.float64) ** CONFIDENCE_POWER
    pooled = np.empty(len(position), np.float32)
    for begin in range(0, len(position), BATCH):
        part = slice(begin, begin + BATCH)
        pooled[part] = _pooled(materials, known, np.arange(len(position))[part], around[part])
    return pooled


def _pooled(materials: np.ndarray, known: np.ndarray, own: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Return the pooled roughness (M,) of the surfels `own` (M,) with the sources `around` (M, K) of each."""
    albedo, metal = materials[ALBEDO], materials[METALLIC] > METALLIC_THRESHOLD
    alike = np.exp(-ALBEDO_DECAY * np.abs(albedo[:, around] - albedo[:, own, None]).sum(0)) * (metal[around] == metal[own, None])
    weight = alike * known[around]
    total = np.maximum(weight.sum(1), 1e-30)
    others, their_weight = (weight * materials[ROUGHNESS][around]).sum(1) / total, (weight * known[around]).sum(1) / total
    share = OWN_WEIGHT * known[own] / (OWN_WEIGHT * known[own] + their_weight)
    return share * materials[ROUGHNESS][own] + (1 - share) * others
