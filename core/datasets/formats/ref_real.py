# SPDX-License-Identifier: GPL-3.0-or-later
"""Conventions of the real scenes of Ref-NeRF: COLMAP models of whole surroundings, with a published sphere of interest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...scene.dataset import Bound
from ..bound import find_look_at_point
from ..parsed_dataset import ParsedDataset
from ..world_frame import approximate_camera

# Centre and radius in the models' own frames, as the reflective Gaussian methods use them.
SPHERES = {
    "gardenspheres": ((-0.2270, 1.9700, 1.7740), 0.974),
    "sedan": ((-0.032, 0.808, 0.751), 2.138),
    "toycar": ((0.486, 1.108, 3.72), 2.507),
}


def is_ref_real(folder: Path) -> bool:
    """Return True if the images exist at full, quarter and eighth size, but not at half size as in other collections."""
    reduced = {n for n in (2, 4, 8) if (folder / f"images_{n}").is_dir()}
    return (folder / "images").is_dir() and reduced == {4, 8}


def with_published_sphere(parsed: ParsedDataset) -> ParsedDataset:
    """Return a Ref-NeRF scene with the published sphere of interest as its bound, if there is one for its name.

    Another scene of the same name is recognised by its cameras, which look at a point outside that sphere: a warning is added instead.
    """
    parsed = replace(parsed, format="ref-real")
    if parsed.root.name not in SPHERES:
        return parsed
    centre, radius = SPHERES[parsed.root.name]
    centre = parsed.to_world[:3, :3] @ centre + parsed.to_world[:3, 3]
    target = find_look_at_point([approximate_camera(f) for f in parsed.train])
    if np.linalg.norm(centre - target.point) > radius:
        return replace(parsed, warnings=[*parsed.warnings, f"{parsed.root}: the published sphere of interest does not fit the cameras"])
    x, y, z = (float(v) for v in centre)
    return replace(parsed, bound=Bound((x, y, z), radius))
