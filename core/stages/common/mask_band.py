# SPDX-License-Identifier: GPL-3.0-or-later
"""Band at the edge of a mask that may be wrong: there the colours decide what is the object, and the mask counts less.

In the band a photograph is compared with the rendered object over the background, as in matting. The background is unknown behind the
object, so it is continued from the pixels beside the band. Surfels beside the object can take the background's colour at no cost, so that
outlines grow by .2 to .4 pixels. A mask that the colours have cut (`View.cut_by_colours`) is therefore followed, without a band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.mask_limits import narrowest_mask, widest_mask
from ...io.continued_colour import continued_colour
from ...io.srgb import decode_srgb
from ...scene.dataset import View

MIN_OBJECT_OPACITY = 0.5  # opacity from which a mask says that a pixel is the object
# Sigma of the window from which the background is continued, in widths of the band; doubled until it reaches all of the band.
WINDOW_SIGMA = 1.0
MAX_WINDOWS = 6  # windows


@dataclass(frozen=True, eq=False)
class MaskBand:
    """Band at the edge of a view's mask.

    Attributes:
        pixels: (H, W) bool, True in the band.
        background: (H, W, 3) float32 linear radiance beside the object, 0 outside the band.
    """

    pixels: np.ndarray
    background: np.ndarray


def find_mask_band(view: View) -> MaskBand | None:
    """Return the band of a view's mask; None without a mask, or where its edge is known."""
    if view.alpha is None or view.cut_by_colours or round(view.mask_error) < 1:
        return None
    outside = widest_mask(view) < MIN_OBJECT_OPACITY
    band = ~outside & (narrowest_mask(view) < MIN_OBJECT_OPACITY)
    background = continued_colour(decode_srgb(view.colour), outside, WINDOW_SIGMA * 2 * view.mask_error, MAX_WINDOWS, band)
    return MaskBand(band, np.where(band[..., None], background, 0).astype(np.float32))
