# SPDX-License-Identifier: GPL-3.0-or-later
"""Small rendered scenes with ground truth, of kinds that the demo dataset is not: tests/scenes."""

from __future__ import annotations

from pathlib import Path

SCENES = Path(__file__).resolve().parents[1] / "scenes"
NAMES = ("bowl", "relief")


def small_scene(name: str) -> Path:
    """Return the folder of a scene, which `load_dataset` reads.

    Args:
        name: one of NAMES.
    """
    assert name in NAMES, name
    return SCENES / name
