# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures with troubles: exposure and white balance that change, masks and poses that are wrong, a passer-by."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import torch
from irgspp.core.capture.mask_consistency import overlap
from irgspp.core.capture.object_masks import cut_out
from irgspp.core.datasets.exposure import even_exposures
from irgspp.core.io.srgb import decode_srgb, encode_srgb
from irgspp.core.kernels.rasterize import rasterize
from irgspp.core.progress.protocol import Silent
from irgspp.core.rendering.deferred import composite, radiance
from irgspp.core.scene.dataset import Bound, Dataset, PointCloud, View
from irgspp.core.settings.overrides import with_overrides
from irgspp.core.settings.schema import CaptureSettings, preset
from irgspp.core.stages.common.training_view import camera_rays
from irgspp.core.stages.first.train import train

from .case import Measured, group
from .table_scene import OBJECT, TableScene, photographed_table

case = group("captures")
BRIEF = with_overrides(preset("draft"), ["first.gaussians=2000", "first.iterations=240", "materials=low-gloss"])
BOUND = Bound((0.0, 0.0, 0.5), 0.75)
DISTANCE = 3.6  # of the cameras to the object
PASSER_BY = (0.75, 0.55, 0.45)  # encoded colour


@cache
def scene() -> TableScene:
    """Return the photographs of a box on a table, made once."""
    return photographed_table()


def dataset(views: list[View]) -> Dataset:
    """Return a dataset of some photographs of the box."""
    return Dataset(Path("box"), "transforms", views, [], BOUND, np.eye(4), scene().points)


def masked(change=lambda mask: mask, mask_error: float = 0.0) -> list[View]:
    """Return the photographs with their true masks (H, W), changed by a function.

    Args:
        change: of a mask.
        mask_error: pixels by which the masks are said to be wrong.
    """
    return [replace(view, alpha=change(scene().masks[view.name]), mask_error=mask_error) for view in scene().views]


def fit(views: list[View]) -> tuple[float, float]:
    """Fit Gaussians briefly and compare them with the true photographs.

    Args:
        views: photographs to fit.

    Returns:
        Area between the rendered outline and the true one over the object's, and PSNR in dB of the radiance inside the object.
    """
    fitted, _ = train(dataset(views), BRIEF)
    g, wrong, area, error, count = fitted.gaussians, 0.0, 0.0, 0.0, 0.0
    for view in scene().views:
        sums, _ = rasterize(
            g.position, g.quaternion, g.log_scale, g.opacity, g.sh, g.position.new_zeros(0, g.count), view.camera, BOUND.radius
        )
        true = torch.from_numpy(scene().masks[view.name])
        wrong, area = wrong + float((sums[-1] - true).abs().sum()), area + float(true.sum())
        image = composite(radiance(sums, camera_rays(view.camera), None), sums[-1], camera_rays(view.camera), None)
        inside = true > 0.99
        error += float((image.permute(1, 2, 0)[inside] - torch.from_numpy(view.colour)[inside]).square().sum())
        count += 3 * float(inside.sum())
    return wrong / area, -10 * float(np.log10(error / count))


@cache
def many_points() -> PointCloud:
    """Return as many points of the box and the table as a capture has; some are hidden in each view, as there."""
    rng = np.random.default_rng(1)
    table = np.concatenate([rng.uniform(-1.5, 1.5, (3000, 2)), np.zeros((3000, 1))], 1)
    position = np.concatenate([OBJECT.surface(1500, rng), table]).astype(np.float32)
    return PointCloud(position, np.full_like(position, 0.5))


def exposed(gains: np.ndarray) -> list[View]:
    """Return the photographs taken with gains (V, 3)."""
    return [
        replace(view, colour=np.clip(encode_srgb(decode_srgb(view.colour) * gain), 0, 1).astype(np.float32))
        for view, gain in zip(scene().views, gains, strict=True)
    ]


def gains_left(gains: np.ndarray) -> float:
    """Return the largest factor, in EV, by which photographs differ after `even_exposures`; gains: (V, 3) they were taken with."""
    even = even_exposures(exposed(gains), many_points(), "auto", [])
    ratios = [_log_ratio(view.colour, true.colour) for view, true in zip(even, scene().views, strict=True)]
    return float(np.ptp(ratios, axis=0).max())


def _log_ratio(colour: np.ndarray, true: np.ndarray) -> list[float]:
    """Return the median ratio of two photographs (H, W, 3) in EV for each channel, where neither is clipped or dark."""
    usable = (colour < 0.9) & (colour > 0.1) & (true > 0.1)
    return [
        float(np.median(np.log2(decode_srgb(colour[..., k][on]) / decode_srgb(true[..., k][on]))))
        for k in range(3)
        for on in [usable[..., k]]
    ]


@case("exposure in steps of 2 EV", "half an EV of the steps is left at most")
def exposure_steps(m: Measured) -> None:
    """Expose every other photograph by 2 EV less."""
    gains = np.where(np.arange(len(scene().views)) % 2, 0.25, 1.0)[:, None].repeat(3, 1)
    m.at_most("difference left, EV", gains_left(gains), 0.5)


@case("white balance off by 20 %", "at most a third of the difference is left")
def white_balance(m: Measured) -> None:
    """Warm every third photograph, cool another third."""
    table = np.array([[1.2, 1.0, 1 / 1.2], [1.0, 1.0, 1.0], [1 / 1.2, 1.0, 1.2]])
    m.at_most("difference left, EV", gains_left(table[np.arange(len(scene().views)) % 3]), 0.15)


@case("masks eroded and grown", "the fit holds with masks that are wrong by 1 or 3 pixels, 2 to 5 % of the object's size", quick=False)
def wrong_masks(m: Measured) -> None:
    """Erode and grow all masks; the error is stated."""
    # What lies beside the object in a grown mask may be painted onto it, so that grown masks cost more than eroded ones.
    for name, change, limits in (("eroded", cv2.erode, (0.07, 0.12)), ("grown", cv2.dilate, (0.18, 0.6))):
        for pixels, limit in zip((1, 3), limits, strict=True):
            kernel = np.ones((2 * pixels + 1, 2 * pixels + 1), np.uint8)
            wrong = masked(lambda mask, change=change, kernel=kernel: change(mask, kernel), pixels)
            outline, psnr = fit(wrong)
            m.at_most(f"area between the outlines, {name} by {pixels}", outline, limit)
            m.at_least("radiance, dB", psnr, 17)


@case("masks missing in a third of the views", "the missing ones are found, and the others kept")
def missing_masks(m: Measured) -> None:
    """Give two thirds of the masks."""
    given = {name: mask for i, (name, mask) in enumerate(scene().masks.items()) if i % 3}
    found = cut_out(scene().views, scene().points, CaptureSettings(), 0, Silent(), given=given)
    m.holds("the object is found", found is not None)
    if found is not None:
        m.at_least("smallest IoU", _overlaps(found.masks).min(), 0.9)


@case("poses off by 0.1 % of the distance", "the fit degrades by little", quick=False)
def slightly_wrong_poses(m: Measured) -> None:
    """Move the cameras at random by as much as bundle adjustment leaves."""
    m.at_least("radiance, dB", fit(displaced(0.001))[1], 24)


@case("poses off by 1 % of the distance", "the fit degrades, and does not break")
def wrong_poses(m: Measured) -> None:
    """Move the cameras at random."""
    m.at_least("radiance, dB", fit(displaced(0.01))[1], 17)


def displaced(share: float) -> list[View]:
    """Return the photographs with true masks, whose cameras are said to be elsewhere: at random by a share of their distance."""
    rng, views = np.random.default_rng(0), []
    for view in masked():
        moved = view.camera.to_world.copy()
        moved[:3, 3] += share * DISTANCE * rng.normal(size=3) / np.sqrt(3)
        views.append(replace(view, camera=replace(view.camera, to_world=moved)))
    return views


@case("a passer-by in three photographs", "the object is cut out of all photographs all the same")
def passer_by(m: Measured) -> None:
    """Draw a figure beside the object into three photographs."""
    views = list(scene().views)
    for i in (1, 5, 6):
        colour = views[i].colour.copy()
        height, width = colour.shape[:2]
        cv2.ellipse(colour, (int(0.16 * width), int(0.5 * height)), (int(0.1 * width), int(0.45 * height)), 0, 0, 360, PASSER_BY, -1)
        views[i] = replace(views[i], colour=colour)
    found = cut_out(views, scene().points, CaptureSettings(), 0, Silent())
    m.holds("the object is found", found is not None)
    if found is not None:
        m.at_least("smallest IoU", _overlaps(found.masks).min(), 0.85)


def _overlaps(masks) -> np.ndarray:
    """Return the IoU (V,) of masks with the true ones; 0 where there is none."""
    pairs = zip(masks, scene().masks.values(), strict=True)
    return np.array([0.0 if mask is None else overlap(mask, true) for mask, true in pairs])
