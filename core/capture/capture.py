# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture of bare photographs or a video: cameras, undistorted images, masks, exposure gains and true size, as a dataset folder."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.bound import bound_of_cameras, bound_of_points
from ..datasets.formats.captured import EXPOSURES, FILE, FORMAT, SURROUNDINGS, load_capture
from ..errors import InputError
from ..io.file_lock import FileLock
from ..io.image import read_image
from ..progress.protocol import Progress, Silent
from ..scene.dataset import Bound, PointCloud
from ..scene.surroundings import save_surroundings
from ..settings.schema import CaptureSettings
from .dataset_files import write_json, write_masks, write_model, write_transforms
from .description import CaptureResult, describe
from .exposures import exposure_gains
from .marker import find_marker_scale
from .near_surfaces import near_surfaces
from .object_masks import ObjectMasks, cut_out
from .photograph import LeftOut
from .poses import find_poses
from .reading import read_photographs
from .report import write_contact_sheet, write_page
from .sparse_model import SparseModel
from .static_background import SeenBackground, light_rotations
from .turntable import find_turntable
from .undistortion import UndistortedImage, undistort_photographs
from .upright import world_similarity

LOCK = ".lock"


def capture(source: Path, folder: Path, settings: CaptureSettings, seed: int = 0, progress: Progress | None = None) -> Path:
    """Capture photographs into a dataset folder, and return the folder; an interrupted capture goes on, a finished one is kept.

    Args:
        source: folder of photographs and videos, or a video; it is never changed.
        folder: folder to write.
        settings: settings of the capture.
        seed: seed of every random number generator.
        progress: receives the progress and may cancel; None for neither.

    Raises:
        InputError: if there are too few usable photographs, they don't overlap, or the folder holds something else.
        Cancelled: if the user stopped the work.
    """
    watcher = progress or Silent()
    inputs = {"source": str(source.resolve()), "settings": dataclasses.asdict(settings), "seed": seed}
    new, lock = not folder.exists(), _claim(folder)
    try:
        before = load_capture(folder / FILE) if (folder / FILE).exists() else {}
        if before.get("status") == "done" and before.get("inputs") == inputs:
            watcher.message(f"capture: finished before, in {folder}")
            return folder
        write_json(folder / FILE, {"format": FORMAT, "status": "running", "inputs": inputs})
        _capture(source, folder, settings, seed, watcher, inputs)
    except InputError:
        if new:  # what can't be captured leaves nothing behind
            shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        lock.release()
    return folder


def _claim(folder: Path) -> FileLock:
    """Make the folder and lock it; raise InputError where it holds something else."""
    if folder.exists() and (not folder.is_dir() or (not (folder / FILE).exists() and any(p.name != LOCK for p in folder.iterdir()))):
        raise InputError(folder, "is not empty and not a capture", "name another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return FileLock(folder / LOCK)
    except BlockingIOError as error:
        raise InputError(folder, "is in use by another process") from error
    except OSError as error:
        raise InputError(folder, f"can't be written ({error.strerror})") from error


def _capture(source: Path, folder: Path, settings: CaptureSettings, seed: int, progress: Progress, inputs: dict[str, Any]) -> None:
    photographs, left_out = read_photographs(source, folder, settings, progress)
    _report_left_out(left_out, progress)
    turntable = find_turntable(photographs, settings.turntable, progress)
    model = find_poses(photographs, folder, settings, seed, progress, turntable)
    _report_left_out(model.left_out, progress)
    images = undistort_photographs(model, folder, settings.resolution, progress)
    seen = None if turntable is None else SeenBackground.of(turntable, photographs, images)
    found = _masks(model, images, settings, seed, progress, seen)
    gains = exposure_gains(model, [one.view for one in images]) if seen is None else seen.gains
    scale = _metres_per_unit(model, settings, progress)
    bound = _scene_bound(model, images) if found is None else found.bound
    plane = None if found is None or found.plane is None else (found.plane.normal, found.plane.offset)
    similarity = world_similarity([one.camera for one in images], bound, plane, scale)
    turns = None if turntable is None else light_rotations(images, similarity)
    result = CaptureResult(model, images, found, gains, similarity, scale is not None, [*left_out, *model.left_out], turns)
    _write(result, folder, {"format": FORMAT, "status": "done", "inputs": inputs, "source": str(source), **describe(result)})
    progress.message(f"capture: {len(images)} photographs, report in {folder / 'report.html'}")


def _write(result: CaptureResult, folder: Path, state: dict[str, Any]) -> None:
    """Write the dataset's files, and last capture.json, whose content `state` says that they are complete."""
    images, masks = result.images, result.masks
    write_model(result.model, images, result.similarity, folder)
    write_masks(images, masks, folder)
    write_transforms(images, result.similarity, [mask is not None for mask in masks], folder, result.light_rotations)
    _write_surroundings(result, folder)
    write_json(folder / EXPOSURES, {one.view.name: gain.tolist() for one, gain in zip(images, result.gains, strict=True)})
    write_contact_sheet(images, masks, set(result.doubtful), folder / "contact_sheet.png")
    write_page(state, folder / "report.html")
    write_json(folder / FILE, state)


def _masks(
    model: SparseModel,
    images: list[UndistortedImage],
    settings: CaptureSettings,
    seed: int,
    progress: Progress,
    seen: SeenBackground | None,
) -> ObjectMasks | None:
    """Cut the object out, unless the settings say not to."""
    given = {one.view.name: one.mask for one in images if one.mask is not None}
    points = PointCloud(model.position.astype(np.float32), model.colour.astype(np.float32) / 255)
    background = None if seen is None else seen.masks
    return cut_out([one.view for one in images], points, settings, seed, progress, given=given or None, background=background)


def _metres_per_unit(model: SparseModel, settings: CaptureSettings, progress: Progress) -> float | None:
    """Return the model's scale by the printed marker; None where none is expected or found."""
    if settings.marker is None:
        return None
    marker = find_marker_scale(model, settings.marker, lambda photograph: _eight_bits(read_image(photograph.image).colour))
    if marker is None:
        progress.message("no marker was found in three photographs: the true size is not known; print it larger, or lay it flat and lit")
        return None
    progress.message(f"marker {marker.name}, found in {marker.photographs} photographs to {marker.error:.2f} pixels, gives the true size")
    return marker.metres_per_unit


def _eight_bits(colour: np.ndarray) -> np.ndarray:
    return colour if colour.dtype == np.uint8 else (colour >> 8).astype(np.uint8)


def _write_surroundings(result: CaptureResult, folder: Path) -> None:
    """Write the surfaces around the object, in the world; without masks they are part of the scene."""
    path, found = folder / SURROUNDINGS, result.found
    path.unlink(missing_ok=True)
    around = None if found is None else near_surfaces(found.points, found.on_object, found.plane, found.bound)
    if around is not None:
        save_surroundings(around.moved(result.similarity), path)


def _report_left_out(left_out: list[LeftOut], progress: Progress) -> None:
    for one in left_out:
        progress.message(f"left out {one.name}: {one.reason}")


def _scene_bound(model: SparseModel, images: list[UndistortedImage]) -> Bound:
    """Return the sphere about what the cameras look at, where no object was cut out."""
    cameras = [one.camera for one in images]
    return bound_of_points(cameras, model.position) or bound_of_cameras(cameras)
