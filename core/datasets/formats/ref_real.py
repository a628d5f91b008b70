# SPDX-License-Identifier: GPL-3.0-or-later
"""The real scenes of Ref-NeRF: COLMAP models of whole surroundings, with a published sphere around what is of interest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...scene.dataset import Bound
from ..bound import focus_of
from ..parsed_dataset import ParsedDataset
from ..world_frame import rough_camera

# Centre and radius in the models' own frames, as the reflective Gaussian methods use them.
SPHERES = {
    "gardenspheres": ((-0.2270, 1.9700, 1.7740), 0.974),
    "sedan": ((-0.032, 0.808, 0.751), 2.138),
    "toycar": ((0.486, 1.108, 3.72), 2.507),
}


def is_ref_real(folder: Path) -> bool:
    """True where the images are there whole, at a quarter and at an eighth, and not at a half as in other collections."""
    there = {n for n in (2, 4, 8) if (folder / f"images_{n}").is_dir()}
    return (folder / "images").is_dir() and there == {4, 8}


def published_sphere(capture: ParsedDataset) -> ParsedDataset:
    """The capture of such a scene, with the sphere of interest as its bound where it is one of those with a published one.

    A scene that has nothing but the name in common with them is told by its cameras, which look at something outside that sphere.
    """
    capture = replace(capture, format="ref-real")
    if capture.root.name not in SPHERES:
        return capture
    centre, radius = SPHERES[capture.root.name]
    place = capture.to_world[:3, :3] @ centre + capture.to_world[:3, 3]
    focus = focus_of([rough_camera(f) for f in capture.train])
    if np.linalg.norm(place - focus.point) > radius:
        return replace(capture, warnings=[*capture.warnings, f"{capture.root}: the published sphere of interest does not fit the cameras"])
    x, y, z = (float(v) for v in place)
    return replace(capture, bound=Bound((x, y, z), radius))
