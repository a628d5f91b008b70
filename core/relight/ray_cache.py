# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays that the relighter keeps from light to light, and its counter of rays."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import torch

from .indirect_light import SecondaryRays, ShadingPoints
from .visibility_cache import VisibilityCache


class RayCounter(Counter[str]):
    """Counter of rays over all images.

    Keys: "traced", "kept" (taken from an earlier light), "open" (not traced because neighbouring rays met nothing); with
    `RelightSettings.error` also "samples" and "pixels".
    """

    def add(self, kind: str, count: int) -> None:
        """Increase a count.

        Args:
            kind: key.
            count: number to add.
        """
        self[kind] += count

    def __str__(self) -> str:
        """Return the counts as one line for the user."""
        total = self["traced"] + self["kept"] + self["open"]
        text = f"{self['traced'] / 1e6:.1f} of {total / 1e6:.1f} million rays traced"
        skipped = (("kept", "reused from another light"), ("open", "known to be unoccluded"))
        reasons = [f"{self[kind] / 1e6:.1f} {reason}" for kind, reason in skipped if self[kind]]
        text += f" ({', '.join(reasons)})" if reasons else ""
        return text + (f"; {self['samples'] / self['pixels']:.0f} samples per pixel" if self["pixels"] else "")


@dataclass(frozen=True, eq=False)
class CachedRays:
    """Everything that stays the same from light to light for some points of a surface.

    Attributes:
        points: P points to be lit.
        shift: (P, 2) shift of each point's samples on the torus.
        rays: cosine and visible-normal samples, traced.
        visibility_cache: directions that these rays found unoccluded, for light-map samples.
    """

    points: ShadingPoints
    shift: torch.Tensor
    rays: SecondaryRays
    visibility_cache: VisibilityCache

    @property
    def size(self) -> int:
        """Return the bytes in memory."""
        return self.rays.size + self.visibility_cache.size + 48 * len(self.shift)
