# SPDX-License-Identifier: GPL-3.0-or-later
"""Writers of a rendered scene in the layout of each supported dataset, to test the readers with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from . import (
    captured,
    glossy_real,
    glossy_synthetic,
    instant_ngp,
    metashape,
    nerf_synthetic,
    nerfstudio,
    realitycapture,
    ref_real,
    stanford_orb,
    synthetic4relight,
    tensoir,
)
from .source import Source

# Each writes a scene into a folder and returns what to read, and the similarity from the scene's world to the dataset's own frame.
WRITERS: dict[str, Callable[[Source, Path], tuple[Path, np.ndarray]]] = {
    "capture": captured.write,
    "tensoir": tensoir.write,
    "nerf-synthetic": nerf_synthetic.write,
    "synthetic4relight": synthetic4relight.write,
    "glossy-synthetic": glossy_synthetic.write,
    "glossy-real": glossy_real.write,
    "ref-real": ref_real.write,
    "stanford-orb": stanford_orb.write,
    "nerfstudio": nerfstudio.write,
    "instant-ngp": instant_ngp.write,
    "metashape": metashape.write,
    "realitycapture": realitycapture.write,
}
