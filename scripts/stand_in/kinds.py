# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of stand-ins: the published datasets whose layout they have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from formats import WRITERS, stanford_orb
from formats.source import Source

Write = Callable[[Source, Path], tuple[Path, np.ndarray]]


@dataclass(frozen=True)
class Kind:
    """Dataset to stand in for.

    Attributes:
        scenes: built-in scene by name.
        lights: names of the light maps, the training light first.
        write: writer of its layout.
        options: further words of scripts/render_dataset.py.
    """

    scenes: dict[str, str]
    lights: tuple[str, ...]
    write: Write
    options: tuple[str, ...] = ()


KINDS = {
    "tensoir": Kind(
        {"monkey": "low-gloss", "bowl": "bowl"}, ("sunset", "bridge", "city", "fireplace", "forest", "night"), WRITERS["tensoir"]
    ),
    "synthetic4relight": Kind(
        {"stone": "relief", "vase": "glazed-vase"}, ("outdoors", "indoors", "fireplace"), WRITERS["synthetic4relight"], ("--hdr",)
    ),
    "glossy-synthetic": Kind({"monkey": "glossy", "vase": "vase"}, ("indoors", "corridor", "golf", "neon"), WRITERS["glossy-synthetic"]),
    "glossy-real": Kind({"monkey": "glossy", "vase": "vase"}, ("indoors",), WRITERS["glossy-real"], ("--table",)),
    # The sphere of interest goes by the scene's name, so these have published names.
    "ref-real": Kind({"sedan": "demo", "toycar": "vase"}, ("outdoors",), WRITERS["ref-real"], ("--table",)),
    "stanford-orb": Kind(
        {"monkey": "demo", "vase": "glazed-vase"}, ("indoors", "outdoors", "sunset"), partial(stanford_orb.write, trained=1), ("--hdr",)
    ),
}
