# SPDX-License-Identifier: GPL-3.0-or-later
"""Incremental structure from motion (Schönberger and Frahm 2016) on matched features, and its final bundle adjustment."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap

from ..progress.protocol import Progress
from .colmap_library import run_call

ROBUST_SCALE = 1.0  # pixels of error at which the final adjustment begins to distrust an observation (Cauchy's loss)
ROBUST_ITERATIONS = 10  # of the final adjustment; more change the poses by less than a tenth of their error
GLOBAL_GROWTH = 1.5  # the model grows by this factor between two global adjustments; 1.1 takes a fifth longer for the same poses
TOLERANCE = 1e-5  # relative change of the error at which an adjustment ends; without, a quarter longer for the same poses
MIN_MODEL_PHOTOGRAPHS = 3  # photographs
FOCAL_RANGE = (0.3, 20.0)  # possible focal lengths, in long sides of the image
MAX_FOCAL_CHANGE = 1.6  # largest factor between the focal length of EXIF and the refined one


class Freedom(Enum):
    """Intrinsics that are refined, fewer and fewer; the principal point is always the image's centre."""

    FULL = "focal lengths and distortion coefficients"
    RADIAL = "one focal length and one distortion coefficient"
    FIXED = "none"


@dataclass(frozen=True)
class Attempt:
    """Settings of one run of the mapper.

    Attributes:
        lenient: accept fewer matches and smaller angles between rays.
        freedom: intrinsics that are refined.
    """

    lenient: bool = False
    freedom: Freedom = Freedom.FULL


def map_photographs(path: Path, count: int, attempt: Attempt, seed: int, progress: Progress) -> list[pycolmap.Reconstruction]:
    """Find poses and points; one thread, since only then two runs give the same result.

    Args:
        path: the database with the matches.
        count: number of photographs.
        attempt: settings of this run.
        seed: seed of RANSAC.
        progress: receiver; it may cancel.

    Returns:
        Models that have no photograph in common or few, the one with the most photographs first.

    Raises:
        Cancelled: if the user stopped the job.
    """
    progress.phase("find poses", count)
    registered = [0]

    def registered_more(number: int) -> None:
        registered[0] = min(registered[0] + number, count)

    def call(token: pycolmap.CancellationToken) -> dict[int, pycolmap.Reconstruction]:
        folder = path.parent / "models"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        try:
            callbacks = (lambda: registered_more(2)), (lambda: registered_more(1))
            return pycolmap.incremental_mapping(path, path.parent, folder, _options(attempt, seed), "", *callbacks, token)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    pycolmap.set_random_seed(seed)
    models = run_call(call, progress, "stopped while poses were searched", lambda: registered[0])
    progress.step(count)
    return sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D()))


def _options(attempt: Attempt, seed: int) -> pycolmap.IncrementalPipelineOptions:
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = options.mapper.num_threads = 1
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    options.extract_colors, options.min_model_size = False, MIN_MODEL_PHOTOGRAPHS
    options.ba_refine_focal_length = options.mapper.abs_pose_refine_focal_length = attempt.freedom is not Freedom.FIXED
    options.ba_refine_extra_params = options.mapper.abs_pose_refine_extra_params = attempt.freedom is not Freedom.FIXED
    options.ba_global_frames_ratio = options.ba_global_points_ratio = GLOBAL_GROWTH
    options.ba_global_max_refinements, options.ba_local_max_refinements = 2, 1
    options.ba_global_function_tolerance = options.ba_local_function_tolerance = TOLERANCE
    if attempt.lenient:
        options.min_num_matches = 10
        options.mapper.init_min_num_inliers, options.mapper.init_min_tri_angle = 40, 6
        options.mapper.abs_pose_min_num_inliers, options.mapper.abs_pose_min_inlier_ratio = 15, 0.15
        options.mapper.max_reg_trials = 6
    return options


def triangulate_again(
    model: pycolmap.Reconstruction, path: Path, attempt: Attempt, seed: int, progress: Progress
) -> pycolmap.Reconstruction:
    """Triangulate points from other matches of the same features, and adjust poses and points to them.

    Args:
        model: poses, found with other matches.
        path: the database with the matches that count.
        attempt: settings of the run that found the poses.
        seed: seed of all random choices.
        progress: receiver; it may cancel.

    Returns:
        The new model.

    Raises:
        Cancelled: if the user stopped the job.
    """
    copied, refined = pycolmap.Reconstruction(model), attempt.freedom is not Freedom.FIXED

    def call(token: pycolmap.CancellationToken) -> pycolmap.Reconstruction:
        with TemporaryDirectory() as folder:
            return pycolmap.triangulate_points(copied, path, path.parent, folder, True, _options(attempt, seed), refined, token)

    found = run_call(call, progress, "stopped while poses were refined", model.num_reg_images)
    refine_robustly(found, attempt.freedom)
    return found


def refine_robustly(model: pycolmap.Reconstruction, freedom: Freedom, scale: float = ROBUST_SCALE) -> None:
    """Adjust all poses, points and intrinsics with a robust loss; principal points stay at the centres.

    Args:
        model: the model, which is changed.
        freedom: intrinsics that are refined.
        scale: pixels of error at which an observation begins to count less.
    """
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_focal_length = options.refine_extra_params = freedom is not Freedom.FIXED
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = scale
    options.ceres.solver_options.max_num_iterations = ROBUST_ITERATIONS
    options.ceres.solver_options.num_threads = 1
    config = pycolmap.BundleAdjustmentConfig()
    for number in sorted(model.reg_image_ids()):
        config.add_image(number)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    model.update_point_3d_errors()


def has_plausible_lenses(model: pycolmap.Reconstruction, given: Sequence[pycolmap.Camera]) -> bool:
    """Check focal lengths and distortion of the cameras that registered photographs have.

    Args:
        model: the model.
        given: cameras before their refinement, with the focal length of EXIF where it is known; camera i + 1 is at index i.
    """
    used = {model.image(number).camera_id for number in model.reg_image_ids()}
    return all(_is_plausible(model.camera(number), given[number - 1]) for number in used)


def _is_plausible(camera: pycolmap.Camera, given: pycolmap.Camera) -> bool:
    """Check the focal length, and that the distortion is monotonic from the image's centre to its corners."""
    focal, longest = camera.mean_focal_length(), max(camera.width, camera.height)
    if not FOCAL_RANGE[0] * longest < focal < FOCAL_RANGE[1] * longest:
        return False
    change = focal / given.mean_focal_length()
    if given.has_prior_focal_length and not 1 / MAX_FOCAL_CHANGE < change < MAX_FOCAL_CHANGE:
        return False
    if abs(np.log(camera.focal_length_x / camera.focal_length_y)) > 0.1:
        return False
    k = [*camera.params[4:6]] if camera.model_name == "OPENCV" else [camera.params[3], 0.0]
    radius = np.linspace(0, np.hypot(camera.width, camera.height) / 2 / focal, 50)
    slope = 1 + 3 * k[0] * radius**2 + 5 * k[1] * radius**4
    return bool((slope > 0.2).all() and (slope < 5).all())
