# SPDX-License-Identifier: GPL-3.0-or-later
"""Start selection: surfels start on dense stereo where the photographs show that it is better than the hull or the sparse points."""

from __future__ import annotations

from dataclasses import dataclass

from ...progress.protocol import Progress
from ...scene.dataset import Dataset
from ...scene.gaussians import Gaussians
from ...settings.schema import Settings
from .depth_anchors import DepthAnchors
from .material_class import COATED, METAL, MaterialClass, with_geometry_rates
from .stereo_initialization import from_stereo
from .trial_fits import HOLD_BACK_FROM, prepare_trial, run_trials


@dataclass(frozen=True, eq=False)
class Start:
    """What the first stage starts with.

    Attributes:
        gaussians: initial values.
        anchors: stereo's depths, where the surfels start on stereo's points and masks tell the object from its surroundings.
    """

    gaussians: Gaussians
    anchors: DepthAnchors | None = None


def select_start(
    dataset: Dataset,
    settings: Settings,
    plain: Gaussians,
    material_class: MaterialClass,
    progress: Progress,
    crop: bool = False,
    plain_psnr: float | None = None,
) -> Start:
    """Select the Gaussians that the first stage starts with: on the hull or the sparse points, or on the points of dense stereo.

    With masks, stereo's points replace the hull where the photographs agree better at their depth (`from_stereo`). Without masks, a trial
    fit on them must predict held-back views better by `first.stereo_margin` dB. A metal keeps the plain start, since stereo sees the
    depth of its reflections.

    Args:
        dataset: views.
        settings: settings of the job; `first.stereo` decides without evidence where it is "on" or "off".
        plain: Gaussians on the hull, or on the sparse points and at random.
        material_class: selected with the plain start.
        progress: receives steps and the decision, and may cancel.
        crop: crop the images of the trial fits to the object.
        plain_psnr: PSNR in dB of the trial fit that selected the class, with the plain start; None where there was none.

    Raises:
        Cancelled: the user stopped the work.
    """
    choice, name = settings.first.stereo, "the visual hull" if dataset.has_alpha else "sparse points"
    reason = _reason_against(dataset, settings, material_class)
    if reason and choice != "on":
        progress.decided("stereo", False, f"started on {name}: {reason}")
        return Start(plain)
    start = from_stereo(dataset, settings.first.gaussians, settings.seed, progress, everywhere=choice == "on")
    if start is None:
        progress.decided("stereo", False, f"started on {name}: stereo found too few points that views agree on")
        return Start(plain)
    stereo = start.gaussians.to(plain.position.device)
    if choice == "on":
        better, evidence = True, "as set"
    elif dataset.has_alpha:
        better, evidence = start.share > 0, _share_in_words(start.share)
    else:
        better, evidence = _trial(dataset, settings, plain, stereo, material_class, progress, crop, plain_psnr)
    progress.decided("stereo", better, evidence)
    anchored = better and dataset.has_alpha and settings.first.anchor_weight > 0
    return Start(stereo if better else plain, DepthAnchors.of_maps(start.maps) if anchored else None)


def _share_in_words(share: float) -> str:
    """Return the evidence with masks: the fraction of the surfels that lie on stereo's points."""
    if share == 0:
        return "in no region does stereo fit the photographs better than the visual hull and differ from it by more than a pixel"
    return f"{share:.1%} of the surfels lie on stereo's points, where the photographs agree better than on the visual hull"


def _trial(
    dataset: Dataset,
    settings: Settings,
    plain: Gaussians,
    stereo: Gaussians,
    material_class: MaterialClass,
    progress: Progress,
    crop: bool,
    plain_psnr: float | None,
) -> tuple[bool, str]:
    """Return whether a trial fit is better with the stereo start, and the evidence; see `select_start`."""
    starts = {"stereo": stereo} if plain_psnr is not None else {"sparse points": plain, "stereo": stereo}
    rated = with_geometry_rates(material_class, COATED)  # as the trial fits that selected the class
    fits = {key: prepare_trial(dataset, settings, start, rated, crop) for key, start in starts.items()}
    progress.phase("start", settings.first.trial_iterations)
    score = ({} if plain_psnr is None else {"sparse points": plain_psnr}) | run_trials(fits, settings, progress)
    better = score["stereo"] > score["sparse points"] + settings.first.stereo_margin
    return better, "held-back views: " + ", ".join(f"{key} {value:.2f} dB" for key, value in score.items())


def _reason_against(dataset: Dataset, settings: Settings, material_class: MaterialClass) -> str:
    """Return the reason why stereo is not tried, empty where there is none."""
    if settings.first.stereo == "off":
        return "as set"
    if material_class == METAL:
        return "a metal's reflections mislead stereo"
    if len(dataset.train) < HOLD_BACK_FROM:
        return f"{len(dataset.train)} photographs, too few to hold any back"
    return ""
