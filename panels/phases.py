# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts for the phases of a reconstruction and of a capture."""

from __future__ import annotations

from ..irgspp_addon.translations import translated

STEPS = (  # of a reconstruction, in order: text, and the phases of the engine that belong to it
    ("Reading photographs and masks", ("read images", "quick fit")),
    ("Choosing the material class and the start", ("materials", "stereo", "start", "gaps", "metal", "spheres", "edges")),
    ("Fitting shape and radiance", ("first stage",)),
    ("Extracting the surface", ("fuse",)),
    ("Solving for light and materials", ("trace", "second stage", "normals", "turn surfels", "paint", "refine", "radiance", "joint")),
    ("Unwrapping the mesh and baking textures", ("unwrap", "bake")),
    ("Writing the Blender file", ("scene",)),
    ("Drawing the contact sheet", ("contact sheet",)),
)
CAPTURE_STEPS = (  # of a capture, in order; a reconstruction of photographs without cameras begins with them
    ("Reading photographs", ("read photographs",)),
    ("Finding features", ("find features",)),
    ("Matching photographs", ("match photographs",)),
    ("Finding the cameras", ("find poses",)),
    ("Undistorting photographs", ("undistort photographs",)),
    ("Refining the cameras", ("dense points", "refine poses")),
    ("Cutting out the object", ("cut out the object",)),
)
# Share of each phase of a reconstruction in its whole time, in percent: rounded means of balanced runs of five scenes. Only captures
# have a quick fit, which takes about 10, and only objects whose gaps may be open a trial of that. The joint optimisation is not in the
# mean: it is the paper preset's, and its schedule is hundreds of times as long.
SHARES = {
    "read images": 1,
    "quick fit": 2,
    "materials": 8,
    "stereo": 5,
    "start": 2,
    "gaps": 2,
    "metal": 2,
    "spheres": 1,
    "edges": 3,
    "first stage": 47,
    "fuse": 4,
    "trace": 1,
    "second stage": 3,
    "normals": 2,
    "turn surfels": 3,
    "paint": 3,
    "refine": 6,
    "radiance": 6,
    "joint": 0,
    "unwrap": 3,
    "bake": 2,
    "scene": 1,
    "contact sheet": 1,
}
NUMBERS = {phase: number for number, (_, phases) in enumerate(STEPS, 1) for phase in phases}
CAPTURE_NUMBERS = {phase: number for number, (_, phases) in enumerate(CAPTURE_STEPS, 1) for phase in phases}


def phase_in_words(kind: str, phase: str) -> str:
    """Return a phase as "Step 3 of 8: Fitting shape and radiance", "Cameras, step 3 of 7: Matching photographs" before.

    Phases of other kinds of jobs keep their names.

    Args:
        kind: of the job.
        phase: as the engine names it; empty before the first.
    """
    number = NUMBERS.get(phase)
    if kind in ("reconstruct", "demo") and number:
        return translated("Step {number} of {count}: {text}", number=number, count=len(STEPS), text=translated(STEPS[number - 1][0]))
    number = CAPTURE_NUMBERS.get(phase)
    if kind in ("reconstruct", "capture") and number:
        template = "Step {number} of {count}: {text}" if kind == "capture" else "Cameras, step {number} of {count}: {text}"
        return translated(template, number=number, count=len(CAPTURE_STEPS), text=translated(CAPTURE_STEPS[number - 1][0]))
    return f"{phase[:1].upper()}{phase[1:]}" if phase else translated("Starting")


def total_fraction(kind: str, phase: str, fraction: float) -> float | None:
    """Return the fraction of a whole reconstruction that is done; None for other jobs and unknown phases.

    Args:
        kind: of the job.
        phase: as the engine names it.
        fraction: of the phase that is done, 0..1.
    """
    if kind not in ("reconstruct", "demo") or phase not in SHARES:
        return None
    before = list(SHARES.values())[: list(SHARES).index(phase)]
    return (sum(before) + fraction * SHARES[phase]) / sum(SHARES.values())
