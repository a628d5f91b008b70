# SPDX-License-Identifier: GPL-3.0-or-later
"""Largest and smallest mask of a view whose mask may be wrong at its edge."""

from __future__ import annotations

import numpy as np

from ..io.grown_mask import grown_mask
from ..scene.dataset import View


def widest_mask(view: View) -> np.ndarray:
    """Return the largest mask (H, W) float32 that the error of a view's mask allows."""
    assert view.alpha is not None
    return grown_mask(view.alpha, view.mask_error)


def narrowest_mask(view: View) -> np.ndarray:
    """Return the smallest mask (H, W) float32 that the error of a view's mask allows."""
    assert view.alpha is not None
    return grown_mask(view.alpha, -view.mask_error)
