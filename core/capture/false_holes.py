# SPDX-License-Identifier: GPL-3.0-or-later
"""False holes of masks: parts of a plain object that a cut took for the table behind them.

A photograph that looks through a true hole shows the table there as other photographs show it, or the other views see no object. A false
hole has the object's colours, lies inside the other views' outline, and hides a part of the table that no photograph shows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from scipy import ndimage

from ..scene.dataset import Bound, View
from .filled_gaps import carved_silhouettes
from .support_plane import SupportPlane

# Mean log-likelihood ratio of background to object by the object's colours, below which a hole has them. Four false holes of a white mug
# have -1.9 to -2.8, a toy car's largest -2.4. Of 223 true holes in seven captures, all three conditions hold for two small ones, which the
# second cut closes by itself.
MAX_EVIDENCE = -1.5
MAX_TEXTURED = 0.5  # fraction of a hole in which the table's texture is known, above which the mask is believed
# Mean sureness with which the other views see the object in a hole, above which it is false. It is at least .94 in the mug's false holes,
# which four views have, and at most .76 in true holes with the object's colours, but for the two small ones.
MIN_SILHOUETTE = 0.9


def holes_like_object(mask: np.ndarray, evidence: np.ndarray, textured: np.ndarray) -> np.ndarray:
    """Return the holes of a mask that have the object's colours and show no known table: (H, W) int32 numbers from 1, 0 elsewhere.

    Args:
        mask: (H, W) 0..1.
        evidence: (H, W) log-likelihood ratio of background to object by the object's colours (`object_evidence`).
        textured: (H, W) bool, where the table's texture is known.
    """
    filled = mask > 0.5
    holes = np.asarray(ndimage.binary_fill_holes(filled), bool) & ~filled
    count, numbers = cv2.connectedComponents(holes.astype(np.uint8), connectivity=4)
    ratio, known = (_means(image, numbers, count - 1) for image in (evidence, textured))
    return np.where(_chosen(numbers, (ratio < MAX_EVIDENCE) & (known < MAX_TEXTURED)), numbers, 0)


def without_false_holes(views: Sequence[View], holes: Sequence[np.ndarray], bound: Bound, plane: SupportPlane) -> list[View]:
    """Return the views with those holes filled in which all other views together see the object.

    Args:
        views: views with masks.
        holes: numbers (H, W) of each view, from `holes_like_object`.
        bound: sphere about the object.
        plane: plane that the object stands on.
    """
    if not any(one.any() for one in holes):
        return list(views)
    found = carved_silhouettes([view.camera for view in views], [_masked(view) for view in views], bound, plane)
    if found is None:
        return list(views)
    return [_without_holes(*parts) for parts in zip(views, holes, found, strict=True)]


def _masked(view: View) -> np.ndarray:
    """Return the pixels (H, W) bool that a view's mask contains."""
    assert view.alpha is not None
    return view.alpha > 0.5


def _without_holes(view: View, holes: np.ndarray, silhouette: np.ndarray) -> View:
    """Return a view with those of its numbered holes (H, W) filled that lie inside the other views' silhouette (H, W)."""
    assert view.alpha is not None
    false = _chosen(holes, _means(silhouette, holes, int(holes.max())) > MIN_SILHOUETTE)
    return replace(view, alpha=np.where(false, np.float32(1), view.alpha)) if false.any() else view


def _chosen(numbers: np.ndarray, choice: np.ndarray) -> np.ndarray:
    """Return the pixels (H, W) bool of the regions with numbers 1..count that are chosen; choice: (count,) bool."""
    return np.append(False, choice)[numbers]


def _means(image: np.ndarray, numbers: np.ndarray, count: int) -> np.ndarray:
    """Return the means (count,) of an image (H, W) over the regions with numbers 1..count; 0 for a number that is nowhere."""
    pixels = np.bincount(numbers.ravel(), minlength=count + 1)
    sums = np.bincount(numbers.ravel(), image.ravel(), minlength=count + 1)
    return (sums / np.maximum(pixels, 1))[1:]
