# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's phases in an artist's words."""

from __future__ import annotations

STEPS = (  # of a reconstruction, in order: what it does, and the phases of the engine that belong to it
    ("Reading photographs", ("read images",)),
    ("Finding out the kind of material", ("materials",)),
    ("Fitting shape and radiance", ("first stage",)),
    ("Fusing the surface", ("fuse",)),
    ("Telling light from materials", ("trace", "second stage", "paint", "refine", "radiance")),
    ("Making mesh and textures", ("unwrap", "bake")),
    ("Writing the Blender file", ("scene",)),
    ("Drawing the overview", ("contact sheet",)),
)
NUMBERS = {phase: number for number, (_, phases) in enumerate(STEPS, 1) for phase in phases}


def phase_in_words(kind: str, phase: str) -> str:
    """What a job does now: "Step 3 of 8: Fitting shape and radiance"; phases of other kinds of jobs by their own names."""
    number = NUMBERS.get(phase)
    if kind in ("reconstruct", "demo") and number:
        return f"Step {number} of {len(STEPS)}: {STEPS[number - 1][0]}"
    return f"{phase[:1].upper()}{phase[1:]}" if phase else "Starting"
