# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 reference of the alignment of patches: a least-squares fit of shift, brightness and contrast on scipy's interpolation."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares


def aligned(image: np.ndarray, places: np.ndarray, patch: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the shift (2,) at which an image fits a patch best, and their normalised cross-correlation there.

    Args:
        image: (H, W).
        places: (M, 2) where the samples are expected, as (x, y), with pixel centres at .5.
        patch: (M,) values of the samples.
    """
    expected = (patch - patch.mean()) / patch.std()

    def seen(shift: np.ndarray) -> np.ndarray:
        x, y = (places + shift - 0.5).T
        values = map_coordinates(np.asarray(image, np.float64), [y, x], order=3, mode="nearest")
        return (values - values.mean()) / values.std()

    shift = least_squares(lambda shift: seen(shift) - expected, np.zeros(2), xtol=1e-12).x
    return shift, float(np.mean(seen(shift) * expected))
