# SPDX-License-Identifier: GPL-3.0-or-later
"""What a reconstruction shows of one view."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..scene.gbuffer import NOTHING, GBuffer


@dataclass(frozen=True, eq=False)
class Prediction:
    """One view of a reconstruction: its layers, and images (H, W, 4) linear premultiplied under its own and under other lights.

    `shaded` is None where the photograph was taken under another light than the reconstruction's.
    """

    buffers: GBuffer
    shaded: np.ndarray | None
    relit: dict[str, np.ndarray] = field(default_factory=dict)

    def layer(self, name: str) -> np.ndarray:
        """A layer of the buffers, 0 where nothing is."""
        values, there = getattr(self.buffers, name), self.buffers.alpha > NOTHING
        return np.nan_to_num(np.where(there if values.ndim == 2 else there[..., None], values, 0))
