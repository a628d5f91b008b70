# SPDX-License-Identifier: GPL-3.0-or-later
"""Duration of a reconstruction on the CPU, estimated before it starts and corrected by the jobs that this machine has done."""

from __future__ import annotations

import json
import math
import statistics
from pathlib import Path

from ..io.atomic import write_atomic
from ..scene.dataset import Dataset
from ..settings.schema import Settings
from ..settings.sizes import gaussians_at_start, takes_photograph_detail, triangles_of_mesh, voxels_along
from .cache_folder import private_folder
from .thread_pool import thread_count

# Seconds on a slow machine with two cores; other machines are told by their own jobs.
START, END = 5.0, 5.0  # of the libraries and the reader, and of the files at the end
STEP, STEP_SURFEL, STEP_PIXEL = 0.005, 6.2e-7, 1.1e-7  # of the first stage, for each surfel, and for each pixel that it fits
UNMASKED = 2.5  # times as long for a pixel without masks, where surfels of the surroundings lie behind one another
TRIAL_STEP, START_STEP = 0.014, 0.025  # of a trial fit that compares classes, and of one that compares starts or edges, at most
LONGEST = 1.5  # longest side of an object in roots of its area: 1.25 to 1.9 on six scenes
SURFACE = 18.0  # stereo, fusion and bake at the balanced preset; by the square of the voxels
PHOTOGRAPH_PIXEL = 2.8e-6  # of stereo, fusion and bake
USUAL_TEXTURE = 1024  # texels along a side of a bake that these include
TEXEL = 2e-6  # of a larger bake with 19 views, and of its detail beside the photographs: 26 + 10 s of one core at 4096, 3 s at 1024
DETAIL_PIXEL = 1.4e-7  # of a full-size photograph, in each of the two passes of the albedo detail
SOLVER = 8.0  # at the balanced preset; by the number of points, views, and texels of the light
NORMALS_TRIANGLE = 1.6e-4  # of the shading normals, for each triangle of the mesh
PAINT = 4.0  # materials of the Gaussians
REFINEMENT_SAMPLE = 1.4e-6  # of a light sample in the refinement, confidence included
RADIANCE_STEP = 1.3  # of the radiance refit, in steps of the first stage
REFERENCE_THREADS, SCALING = 2, 0.5  # threads of the above, and exponent by which others are faster before a job has shown it
LEAST = 60.0  # reference seconds of a job that is kept: shorter ones are mostly start
FASTEST = 0.1  # least ratio of measured over reference seconds that is kept: below, phases must have been left out
SLOWEST = 1000.0  # ratio from which the history must be damaged
KEPT = 9  # jobs whose median corrects the estimate
HISTORY = "job_times.json"


def estimate_seconds(settings: Settings, data: Dataset) -> float | None:
    """Estimate how long a reconstruction will take on this machine's CPU.

    None where that is not known: with the joint solver, which was not measured, or with a time budget, to which schedules are scaled.

    Args:
        settings: of the job, its schedules scaled (`paced`).
        data: the photographs at the resolution of the settings, or at a higher one.
    """
    return corrected_seconds(reference_seconds(settings, data)) if _is_known(settings) else None


def corrected_seconds(reference: float) -> float:
    """Return a duration on this machine, by the jobs that it has done.

    Args:
        reference: seconds on the machine of the constants above.
    """
    return reference * _correction()


def reference_seconds(settings: Settings, data: Dataset) -> float:
    """Estimate how long a reconstruction takes on the machine of the constants above.

    Args:
        settings: of the job, its schedules scaled.
        data: the photographs.
    """
    first = settings.first
    trials = 2 * first.trial_iterations * TRIAL_STEP if settings.materials == "auto" else 0.0
    step, tries_starts = step_seconds(settings, data), first.start_trials or not data.has_alpha
    trials += 2 * first.trial_iterations * min(step, START_STEP) if first.stereo == "auto" and tries_starts else 0.0
    # Open gaps (on half of the objects) and regions of metal are compared with the start, whose fit is made; edges in two shorter fits.
    metal = first.metal_regions == "auto" and settings.materials != "low-gloss"
    masked_trials = 0.5 * (first.stereo == "auto") + metal + 1.2 * (first.open_edges is None)
    trials += first.trial_iterations * min(step, START_STEP) * masked_trials if data.has_alpha and first.start_trials else 0.0
    fit = first.iterations * step
    return START + trials + fit + fixed_seconds(settings, data) + schedule_seconds(settings, data)


def step_seconds(settings: Settings, data: Dataset) -> float:
    """Estimate the mean duration of a step of the first stage; arguments as of `reference_seconds`."""
    depth = 1.0 if data.has_alpha else UNMASKED
    pixels = _fitted_pixels(data, settings.data.resolution) / max(1, len(data.train))
    surfels = gaussians_at_start(settings.first, _object_pixels(data, settings.data.resolution))
    return STEP + STEP_SURFEL * surfels + STEP_PIXEL * depth * pixels


def fixed_seconds(settings: Settings, data: Dataset) -> float:
    """Estimate the duration of the phases beside the first stage that no schedule scales; arguments as of `reference_seconds`."""
    second, pixels = settings.second, _object_pixels(data, settings.data.resolution) or 0.0
    voxels = voxels_along(settings.surface, LONGEST * math.sqrt(pixels))
    surface = SURFACE * (voxels / 192) ** 2 + _fitted_pixels(data, settings.data.resolution) * PHOTOGRAPH_PIXEL
    surface += larger_texture_seconds(settings) + detail_seconds(settings, data)
    if second.solver == "joint":
        return surface + END
    solver = SOLVER * (second.points / 2500) * (second.views / 8) * (second.rows / 12) ** 2
    normals = triangles_of_mesh(settings.surface, pixels) * NORMALS_TRIANGLE
    return surface + solver + normals + PAINT + second.normal_iterations * step_seconds(settings, data) + END


def larger_texture_seconds(settings: Settings) -> float:
    """Estimate how much longer textures take than those of USUAL_TEXTURE texels; `settings` has the texture size."""
    return max(0, settings.surface.texels**2 - USUAL_TEXTURE**2) * TEXEL


def detail_seconds(settings: Settings, data: Dataset) -> float:
    """Estimate the time for decoding and sampling the full-size photographs; arguments as of `reference_seconds`."""
    if not may_take_detail(settings, data):
        return 0.0
    return 2 * DETAIL_PIXEL * len(data.train) * data.full_size_pixels


def may_take_detail(settings: Settings, data: Dataset) -> bool:
    """Return True for a job whose albedo may take detail from the full-size photographs; arguments as of `reference_seconds`."""
    resolution, per_pixel = settings.data.resolution, math.inf
    if data.has_alpha:
        surfels = gaussians_at_start(settings.first, _object_pixels(data, resolution))
        per_pixel = surfels / max(1.0, data.object_pixels * data.reduction**2)
    return takes_photograph_detail(settings.surface.albedo_detail, data.full_size_ratio(resolution), per_pixel)


def schedule_seconds(settings: Settings, data: Dataset) -> float:
    """Estimate the duration of the second stage's schedules; arguments as of `reference_seconds`."""
    second = settings.second
    radiance = RADIANCE_STEP * second.radiance_iterations * step_seconds(settings, data)
    return second.iterations * refinement_step_seconds(settings) + radiance


def refinement_step_seconds(settings: Settings) -> float:
    """Estimate the duration of a step of the refinement."""
    return settings.second.pixels * settings.second.samples * REFINEMENT_SAMPLE


def record_job(settings: Settings, data: Dataset, seconds: float) -> None:
    """Keep how long a finished job took, for the estimates of the next ones; a damaged history starts anew.

    Args:
        settings: of the job, its schedules scaled.
        data: its photographs.
        seconds: that it took on the CPU.

    Raises:
        OSError: the history can't be written.
    """
    reference = reference_seconds(settings, data)
    if reference < LEAST or seconds < FASTEST * reference or not _is_known(settings):
        return
    file, history = _history_file(), _history()
    ratios = [*history.get(_key(), []), round(seconds / reference, 4)]
    write_atomic(file, json.dumps(history | {_key(): ratios[-KEPT:]}).encode())


def in_words(seconds: float) -> str:
    """Return a duration as precisely as an estimate is: "40 s", "3 min" or "2.5 h"."""
    if seconds < 90:
        return f"{max(10, 10 * round(seconds / 10))} s"
    return f"{round(seconds / 60)} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _is_known(settings: Settings) -> bool:
    """Return True for jobs whose time the constants above describe."""
    return settings.second.solver == "closed" and settings.time is None


def _correction() -> float:
    """Return the median of measured over reference seconds of the last jobs with as many threads."""
    ratios = _history().get(_key(), [])
    return statistics.median(ratios) if ratios else (REFERENCE_THREADS / thread_count()) ** SCALING


def _fitted_pixels(data: Dataset, resolution: int) -> float:
    """Count the pixels of the training photographs that the first stage fits: those of the object, where its surroundings are masked."""
    masked, count = data.has_alpha and data.surroundings is None, 0.0
    for view in data.train:
        width, height = view.camera.width, view.camera.height
        share = float(view.alpha.mean()) if masked and view.alpha is not None else 1.0
        count += share * width * height * min(1.0, resolution / max(width, height)) ** 2
    return count


def _object_pixels(data: Dataset, resolution: int) -> float | None:
    """Return the mean number of pixels that show the object after reduction to a resolution; None without masks."""
    if not data.has_alpha:
        return None
    return data.object_pixels * (data.reduction / data.full_size_ratio(resolution)) ** 2


def _key() -> str:
    return f"cpu, {thread_count()} threads"


def _history_file() -> Path:
    return private_folder("times") / HISTORY


def _history() -> dict[str, list[float]]:
    """Read the ratios of measured over reference seconds; empty where there are none, or the file is damaged."""
    try:
        stored = json.loads(_history_file().read_text(encoding="utf-8"))
        return {str(key): [float(ratio) for ratio in ratios if 0 < float(ratio) < SLOWEST] for key, ratios in stored.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}
