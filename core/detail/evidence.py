# SPDX-License-Identifier: GPL-3.0-or-later
"""Evidence for the detail: photographs that it was not made from, compared with the new and the old texture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..io.srgb import encode_srgb
from .candidates import CODES, Candidates

BETTER = 0.97  # error with detail over the error without, below which the detail is used
FEWEST = 500  # texels that the held-back photographs must show


@dataclass
class Evidence:
    """Errors of two textures against held-back photographs.

    Attributes:
        detailed: sum of absolute differences, sRGB-encoded, of the texture with detail.
        plain: the same of the working solution's texture.
        texels: number of compared texels.
    """

    detailed: float = 0.0
    plain: float = 0.0
    texels: int = 0

    def add(self, held: Candidates, detailed: np.ndarray, plain: np.ndarray) -> None:
        """Compare with one photograph.

        Args:
            held: its samples, one candidate per texel.
            detailed: (P, 3) linear albedo with detail, 0 where no other photograph shows the texel.
            plain: (P, 3) linear albedo of the working solution.
        """
        known = np.flatnonzero((held.weight[:, 0] > 0) & (detailed.max(-1) > 0))
        seen = encode_srgb(held.colour[known, 0] / np.float32(CODES))
        self.detailed += float(np.abs(encode_srgb(detailed[known]) - seen).mean(-1).sum())
        self.plain += float(np.abs(encode_srgb(plain[known]) - seen).mean(-1).sum())
        self.texels += len(known)

    @property
    def ratio(self) -> float:
        """Error with detail over the error without."""
        return self.detailed / max(self.plain, 1e-9)

    @property
    def convincing(self) -> bool:
        """True where the detail explains photographs that it was not made from better than the working solution does."""
        return self.texels >= FEWEST and self.ratio < BETTER
