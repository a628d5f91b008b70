# SPDX-License-Identifier: GPL-3.0-or-later
"""Confidence of materials: how well the photographs bear out albedo, roughness and metallic of each surfel.

The expected error is measured without ground truth. Where photographs differ from what the rendering equation predicts, the shape, the
light or the kind of material is wrong. Where little light arrives, the same difference means a larger error of the albedo. And where an
estimate varies among neighbours more than on the rest of the object, it is less certain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ....rendering.secondary_rays import SecondaryTracer
from ....scene.gaussians import ALBEDO, ROUGHNESS
from ....scene.reconstruction import Reconstruction
from ....settings.schema import SecondStageSettings
from ...common.nearest_neighbours import nearest_neighbours
from .pixel_pool import PixelPool, sums_at_surfels
from .refinement import Refinement

PIXELS = 32768  # of the training views, compared with their images
BATCH = 2048  # of them at a time
SAMPLES = (16, 32, 16)  # light samples of each of two estimates
PIXEL_NEIGHBOURS = 32  # nearest surfels whose pixels count for a surfel
VARIATION_NEIGHBOURS = 16  # nearest surfels among which a material's variation is measured
NOISE_ERROR = 0.003  # encoded error up to which places do not differ: rounding to 8 bits and a little more
IRRADIANCE_POWER = 0.7  # power of the irradiance by which an error of the radiance becomes one of the albedo
MIN_IRRADIANCE_RATIO = 1e-3  # least irradiance, over the object's median
VARIATION_POWER = 0.33  # power of the variation among neighbours, over the object's median
HALF_CONFIDENCE_ERROR = 0.02  # expected error at which the confidence is 0.5; albedo then erred by 0.01 to 0.045 on seven scenes
MIN_ALBEDO = 0.01  # least albedo whose logarithm is taken


def with_confidence(
    reconstruction: Reconstruction, pool: PixelPool, tracer: SecondaryTracer, settings: SecondStageSettings, seed: int
) -> Reconstruction:
    """Return a solved reconstruction with the confidence of its materials.

    Args:
        reconstruction: N surfels and light.
        pool: pixels of the training views.
        tracer: tracer of the surfels.
        settings: settings of the second stage.
        seed: seed of the random choice of pixels and of the light samples.
    """
    nearest = nearest_surfels(reconstruction)
    error, irradiance = surfel_errors(Refinement(reconstruction, pool, tracer, settings, seed), nearest, seed)
    materials = reconstruction.gaussians.materials().detach().cpu().numpy()
    expected = expected_errors(error, irradiance, materials, nearest[:, :VARIATION_NEIGHBOURS])
    confidence = torch.from_numpy((1 / (1 + expected / HALF_CONFIDENCE_ERROR)).astype(np.float32)).to(reconstruction.environment.device)
    return replace(reconstruction, confidence=confidence)


def nearest_surfels(reconstruction: Reconstruction) -> np.ndarray:
    """Return the nearest surfels of each, itself included, (N, PIXEL_NEIGHBOURS) or fewer where there are fewer, the nearest first."""
    position = reconstruction.gaussians.position.T
    return nearest_neighbours(position, position, PIXEL_NEIGHBOURS).cpu().numpy()


def surfel_errors(refinement: Refinement, nearest: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Measure how far the photographs differ from the prediction around each surfel.

    Args:
        refinement: refinement of the reconstruction, not begun.
        nearest: (N, K) surfels whose pixels count for a surfel.
        seed: seed of the random choice of pixels and of the light samples.

    Returns:
        (N,) root mean square encoded error, infinite where no photograph shows the surroundings; (N,) irradiance / pi.
    """
    pool, generator = refinement.pool, torch.Generator().manual_seed(seed)
    pixels = torch.randperm(pool.count, generator=generator)[:PIXELS].sort().values.to(refinement.device)
    squared_and_light = torch.cat([torch.stack(refinement.errors(part, SAMPLES, generator), 1) for part in pixels.split(BATCH)])
    values = torch.cat([torch.ones_like(squared_and_light[:, :1]), squared_and_light], 1)
    weight, squared, light = sums_at_surfels(pool, pixels, values, len(nearest))[nearest].sum(1).T
    seen = np.maximum(weight, 1e-12)
    return np.where(weight > 1e-6, np.sqrt(np.maximum(squared / seen, 0)), np.inf), light / seen


def expected_errors(error: np.ndarray, irradiance: np.ndarray, materials: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    """Estimate the errors of the materials, up to a factor that differs between objects.

    Args:
        error: (N,) root mean square encoded error of the radiance around each surfel; may be infinite.
        irradiance: (N,) irradiance / pi.
        materials: (5, N) albedo, roughness, metallic.
        nearest: (N, K) the surfels around each.

    Returns:
        (3, N) of albedo (encoded), roughness and metallic.
    """
    seen = np.isfinite(error)
    light = irradiance / max(float(np.median(irradiance[seen])) if seen.any() else 1.0, 1e-12)
    common = (error + NOISE_ERROR) * np.maximum(light, MIN_IRRADIANCE_RATIO) ** -IRRADIANCE_POWER
    log_albedo = np.log(np.maximum(materials[ALBEDO], MIN_ALBEDO))
    albedo, roughness = log_albedo[:, nearest].std(2).mean(0), materials[ROUGHNESS][nearest].std(1)
    return np.stack([common * _relative(albedo), common * _relative(roughness), common])


def _relative(variation: np.ndarray) -> np.ndarray:
    """Return variations (N,) over their median, to the power VARIATION_POWER."""
    variation = variation + 1e-3
    return (variation / np.median(variation)) ** VARIATION_POWER
