# SPDX-License-Identifier: GPL-3.0-or-later
"""Start selection: surfels start on dense stereo where a trial fit from there predicts held-back views better."""

from __future__ import annotations

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...settings.schema import Settings
from .material_class import COATED, METAL, MaterialClass, with_geometry_rates
from .stereo_initialization import from_stereo
from .trial_fits import HOLD_BACK_FROM, prepare_trial, run_trials


def select_start(
    dataset: Dataset,
    settings: Settings,
    plain: Gaussians,
    material_class: MaterialClass,
    progress: Progress,
    crop: bool = False,
    plain_psnr: float | None = None,
) -> Gaussians:
    """Select the Gaussians that the first stage starts with: on the hull or the sparse points, or on the points of dense stereo.

    Stereo must be better by `first.stereo_margin` dB on held-back views: a hollow that opens brings several. Smaller gains come with
    worse shape on smooth objects, where the hull is more exact than stereo. A metal keeps the plain start without a trial, since stereo
    sees the depth of its reflections.

    Args:
        dataset: views.
        settings: of the job; `first.stereo` decides without a trial where it is "on" or "off".
        plain: Gaussians on the hull, or on the sparse points and at random.
        material_class: selected with the plain start.
        progress: receives steps and the decision, and may cancel.
        crop: crop the images of the trial fits to the object.
        plain_psnr: PSNR in dB of the trial fit that selected the class, with the plain start; None where there was none.

    Raises:
        Cancelled: the user stopped the work.
    """
    name = "the visual hull" if dataset.has_alpha else "sparse points"
    reason = _reason_without_trial(dataset, settings, material_class)
    if reason and settings.first.stereo != "on":
        progress.decided("stereo", False, f"started on {name}: {reason}")
        return plain
    stereo = from_stereo(dataset, settings.first.gaussians, settings.seed, progress)
    if stereo is None:
        progress.decided("stereo", False, f"started on {name}: stereo found too few points that views agree on")
        return plain
    stereo = stereo.to(plain.position.device)
    if settings.first.stereo == "on":
        progress.decided("stereo", True, "as set")
        return stereo
    starts = {"stereo": stereo} if plain_psnr is not None else {name: plain, "stereo": stereo}
    rated = with_geometry_rates(material_class, COATED)  # as the trial fits that selected the class
    fits = {key: prepare_trial(dataset, settings, start, rated, crop) for key, start in starts.items()}
    progress.phase("start", settings.first.trial_iterations)
    score = ({} if plain_psnr is None else {name: plain_psnr}) | run_trials(fits, settings, progress)
    better = score["stereo"] > score[name] + settings.first.stereo_margin
    progress.decided("stereo", better, "held-back views: " + ", ".join(f"{key} {value:.2f} dB" for key, value in score.items()))
    return stereo if better else plain


def _reason_without_trial(dataset: Dataset, settings: Settings, material_class: MaterialClass) -> str:
    """Return the reason why the plain start is taken without a trial, empty where there is none."""
    if settings.first.stereo == "off":
        return "as set"
    if material_class == METAL:
        return "a metal's reflections mislead stereo"
    if len(dataset.train) < HOLD_BACK_FROM:
        return f"{len(dataset.train)} photographs, too few to hold any back"
    return ""
