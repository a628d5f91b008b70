# SPDX-License-Identifier: GPL-3.0-or-later
"""IRGS as the benchmark's baseline: its second stage at a pace that a CPU can do, its way to relight, and the comparison of frame rates."""

from __future__ import annotations

from .store import Results
from .studio import RelightVariant

NAME = "IRGS with its BRDF"  # of its configuration; results of earlier versions, with ours, are called IRGS
# Published: 20,000 iterations of 1024 pixels with 256 samples each.
ITERATIONS, PIXELS, SAMPLES = 800, 1024, 64
FEWER_RAYS = 20_000 * 1024 * 256 // (ITERATIONS * PIXELS * SAMPLES)
OPTIONS = (
    "second.solver=joint",
    "second.brdf=irgs",
    "second.geometry_rate=0",
    "second.sampling=stratified",
    f"second.joint_iterations={ITERATIONS}",
    f"second.pixels={PIXELS}",
    f"second.samples={SAMPLES}",
)
# IRGS relights with 512 samples of the hemisphere and 256 of the light, without what we added since. Its uniform samples of the hemisphere
# are cosine-weighted here, which is less noisy.
RELIT_SAMPLES = 768
RELIT = RelightVariant(
    "gaussian",
    denoise="off",
    others=(("allocation", (2, 0, 1)), ("transfer", False), ("ratio", False), ("divide", False), ("mesh_normals", 0.0)),
)
ABOUT = (
    "IRGS: our first stage, then its second stage (its BRDF without metal, its constant start, fixed geometry, uniform directions, "
    f"its rates and weights), at a pace that a CPU can do: {ITERATIONS:,} iterations of {PIXELS:,} pixels with {SAMPLES} samples (--quick: "
    f"fewer), one of {FEWER_RAYS} rays of its published schedule. It is relit with its {RELIT_SAMPLES} samples a pixel, not denoised, "
    "secondary rays on the Gaussians, by our kernels. Times its rate: its seconds of a frame over ours, at equal or better quality, which "
    "means that our relit PSNR against the true images is at least as high; a dash where it is not."
)


def times_as_fast(results: Results, scene: str, name: str) -> float | None:
    """Return how many times as fast as IRGS a way of relighting is; None where it was not measured, or its images are worse than IRGS'.

    Args:
        results: of the section on reconstruction.
        scene: name of the scene.
        name: key of that section's HEADLINE.
    """
    irgs, ours = (results.get(scene, f"headline, {one}") for one in (NAME, name))
    if irgs is None or ours is None or ours.figures["relight_psnr"] < irgs.figures["relight_psnr"]:
        return None
    return irgs.figures["frame_seconds"] / ours.figures["frame_seconds"]
