# SPDX-License-Identifier: GPL-3.0-or-later
"""Relief evidence: how much of the photographs' fine shading is relief, by the coarser relief that the mesh already has.

Relief and grey paint change the radiance of a point alike, so that one light does not tell them apart there. But relief is rarely fine
alone: the mesh, which stereo and the first stage found without shading, has its coarser part, and the photographs show the shading of
this part. On paint, the mesh is smooth or its noise has nothing to do with the photographs. Fine relief of which the mesh has no trace is
taken for paint.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from .surface_gradient import SurfaceGradient

# Numbers of smoothing passes between which lies the band of wavelengths that is compared, and those of the window around a vertex. They
# spread a value by about 1.4, 2.8 and 7 edges (standard deviation).
FINE_PASSES, COARSE_PASSES, WINDOW_PASSES = 8, 32, 200
# Squared correlation from which on all shading is taken for relief, since the mesh's relief is not exact: .56 in the median of igea_relief,
# .06 of blocks with grey and coloured paint.
RELIEF_CORRELATION = 0.4
MIN_VARIANCE = 1e-12  # of log radiance and log irradiance


def relief_fraction(log_radiance: np.ndarray, log_irradiance: np.ndarray, seen: np.ndarray, operators: SurfaceGradient) -> np.ndarray:
    """Estimate the fraction of the variation of radiance around each vertex that is relief.

    It is the squared correlation of radiance and irradiance within a band of wavelengths and a window around the vertex, over
    RELIEF_CORRELATION.

    Args:
        log_radiance: (V,) log diffuse radiance in the photographs, mean of the colours.
        log_irradiance: (V,) log irradiance by the mesh's normals, mean of the colours.
        seen: (V,) bool, vertices whose radiance is known.
        operators: operators of the mesh.

    Returns:
        (V,) 0..1; 0 where nothing around is seen.
    """
    weight, average = seen.astype(float), operators.average
    values = np.where(seen, np.stack([log_radiance, log_irradiance]), 0.0).T
    fine = _smoothed(values, weight, average, FINE_PASSES)
    radiance, irradiance = (fine - _smoothed(values, weight, average, COARSE_PASSES)).T
    products = np.stack([radiance**2, irradiance**2, radiance * irradiance], 1)
    of_radiance, of_irradiance, covariance = _smoothed(products, weight, average, WINDOW_PASSES).T
    squared = np.maximum(covariance, 0) ** 2 / np.maximum(of_radiance * of_irradiance, MIN_VARIANCE)
    return np.minimum(squared / RELIEF_CORRELATION, 1)


def _smoothed(values: np.ndarray, weight: np.ndarray, average: sparse.csr_matrix, passes: int) -> np.ndarray:
    """Return means (V, K) of values (V, K) with weights (V,), spread over neighbours in so many passes; 0 without weight around."""
    spread = np.concatenate([values * weight[:, None], weight[:, None]], 1)
    for _ in range(passes):
        spread = 0.5 * (spread + average @ spread)
    return spread[:, :-1] / np.maximum(spread[:, -1:], 1e-6)
