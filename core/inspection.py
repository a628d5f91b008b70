# SPDX-License-Identifier: GPL-3.0-or-later
"""A dataset in words: what `irgspp inspect` prints."""

from __future__ import annotations

import numpy as np

from .datasets.dataset import Dataset, View


def describe(data: Dataset) -> str:
    """Format, views, cameras, masks, points, bound and warnings, a line each."""
    digits = 3 - int(np.floor(np.log10(data.bound.radius)))
    x, y, z = (round(c, digits) + 0.0 for c in data.bound.centre)  # + 0.0: no minus before a zero
    lines = [
        f"dataset   {data.path}",
        f"format    {data.format}",
        f"views     {len(data.train)} to learn from, {len(data.test)} to test with",
        f"pictures  {_pictures([*data.train, *data.test])}",
        *(f"lens      {lens}" for lens in data.lenses[:8]),
        f"masks     {_masks(data.train)}",
        f"points    {'none' if data.points is None else f'{len(data.points.position):,}'}",
        f"object    within {data.bound.radius:.4g} of ({x:g}, {y:g}, {z:g}), +Z up",
    ]
    return "\n".join(lines + [f"warning: {line}" for line in data.warnings])


def _pictures(views: list[View]) -> str:
    sizes = sorted({(v.camera.width, v.camera.height) for v in views})
    shown = ", ".join(f"{w} x {h}" for w, h in sizes[:3]) + (f" and {len(sizes) - 3} other sizes" if len(sizes) > 3 else "")
    angles = [2 * np.degrees(np.arctan(v.camera.width / (2 * v.camera.fx))) for v in views]
    low, high = min(angles), max(angles)
    return f"{shown}, {low:.1f} degrees wide" if high - low < 0.05 else f"{shown}, {low:.1f} to {high:.1f} degrees wide"


def _masks(views: list[View]) -> str:
    covered = [float(v.alpha.mean()) for v in views if v.alpha is not None]
    if not covered:
        return "none"
    which = "all views" if len(covered) == len(views) else f"{len(covered)} of {len(views)} views"
    return f"{which}, the object covers {np.mean(covered):.0%} of a picture"
