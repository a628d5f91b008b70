# SPDX-License-Identifier: GPL-3.0-or-later
"""Predictions: G-buffer and rendered images of a reconstruction from one view."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..scene.gbuffer import EMPTY_ALPHA, GBuffer


@dataclass(frozen=True, eq=False)
class Prediction:
    """Reconstruction rendered from one view.

    Attributes:
        buffers: its G-buffer.
        shaded: (H, W, 4), linear premultiplied, under the recovered light; None where the photograph was taken under another light.
        relit: the same under other lights, by their names.
    """

    buffers: GBuffer
    shaded: np.ndarray | None
    relit: dict[str, np.ndarray] = field(default_factory=dict)

    def layer(self, name: str) -> np.ndarray:
        """Return a layer of the G-buffer, (H, W) or (H, W, 3), 0 where no Gaussian is."""
        values, covered = getattr(self.buffers, name), self.buffers.alpha > EMPTY_ALPHA
        return np.nan_to_num(np.where(covered if values.ndim == 2 else covered[..., None], values, 0))
