# SPDX-License-Identifier: GPL-3.0-or-later
"""Report of the albedo detail: whether the texture holds it, why, and how fine texture and photographs are."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class DetailReport:
    """What was done, for run.json.

    Attributes:
        applied: the texture holds detail of the photographs.
        why: reason, in one line.
        photographs: number that the texture was made from.
        correlation: correlation of the texture's fine detail with that of held-back photographs, or None.
        correlation_before: correlation of the texture without the detail of photographs, or None.
        texel: side of a texel on the surface, world units, median.
        pixel: size of the finest pixel on the surface, world units, median over the texels that some photograph sees; or None.
        seen: fraction of the texels that some photograph sees.
    """

    applied: bool
    why: str
    photographs: int = 0
    correlation: float | None = None
    correlation_before: float | None = None
    texel: float | None = None
    pixel: float | None = None
    seen: float = 0.0

    def state(self) -> dict[str, object]:
        """Return the report as JSON holds it, without unnecessary digits."""
        return {name: float(f"{value:.4g}") if isinstance(value, float) else value for name, value in asdict(self).items()}

    def line(self) -> str:
        """Return the report as one line for the user."""
        what = f"albedo detail of {self.photographs} photographs" if self.applied else "no albedo detail"
        density = "" if not self.texel or not self.pixel else f"; {self.pixel / self.texel:.2g} texels per pixel of the photographs"
        return f"{what}: {self.why}{density}"
