# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture of bare photographs or a video: cameras, undistorted images, masks, exposure gains and true size, as a dataset folder.

Photographs of a dataset that has cameras keep these. A person's sphere may choose the object. Cameras and the frame of the dataset are then
those of the capture without it.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..datasets.formats.captured import EXPOSURES, FILE, FORMAT, SURROUNDINGS, load_capture
from ..errors import InputError
from ..io.file_lock import FileLock
from ..progress.protocol import Progress, Silent
from ..scene.surroundings import save_surroundings
from ..settings.schema import CaptureSettings
from .captured_frame import load_frame
from .chosen_sphere import chosen_sphere, other_things
from .dataset_files import write_json, write_masks, write_model, write_transforms
from .description import CaptureResult, describe, with_object_shown
from .exposures import exposure_gains
from .given_cameras import given_model, has_cameras
from .near_surfaces import near_surfaces
from .photograph import LeftOut
from .pose_refinement import refine_poses
from .posed_photographs import PosedPhotographs
from .poses import find_poses
from .reading import read_photographs
from .recapture import captured_settings
from .report import write_contact_sheet, write_page
from .static_background import SeenBackground, light_rotations
from .turntable import find_turntable
from .uncertain_poses import mask_widening, without_uncertain_poses
from .undistortion import undistort_photographs

LOCK = ".lock"
EDITED = "edited_masks"  # copies of masks that were edited before the object was cut out again


def capture(source: Path, folder: Path, settings: CaptureSettings, seed: int = 0, progress: Progress | None = None) -> Path:
    """Capture photographs into a dataset folder, and return the folder; an interrupted capture goes on, a finished one is kept.

    Where a finished capture differs in the person's sphere alone, only the object is cut out again, and the dataset stays as it was until
    that has succeeded.

    Args:
        source: folder of photographs and videos, a video, or a dataset with cameras and without masks; it is never changed.
        folder: folder to write.
        settings: settings of the capture.
        seed: seed of every random number generator.
        progress: receives the progress and may cancel; None for neither.

    Raises:
        InputError: if there are too few usable photographs, they don't overlap, the person's sphere can't be the object's, or the folder
            holds something else.
        Cancelled: if the user stopped the work.
    """
    watcher = progress or Silent()
    chosen_sphere(settings)
    inputs = _inputs(source, settings, seed)
    new, lock = not folder.exists(), _claim(folder)
    try:
        before = load_capture(folder / FILE) if (folder / FILE).exists() else {}
        finished = _finished(before, inputs, folder / FILE)
        if finished == "same":
            watcher.message(f"capture: finished before, in {folder}")
            return folder
        if before.get("status") == "done":
            _keep_edited_masks(folder, watcher)
        if finished != "other sphere":
            write_json(folder / FILE, _running(inputs))
        _capture(source, folder, settings, seed, watcher, inputs)
    except InputError:
        if new:  # what can't be captured leaves nothing behind
            shutil.rmtree(folder, ignore_errors=True)
        raise
    finally:
        lock.release()
    return folder


def _inputs(source: Path, settings: CaptureSettings, seed: int) -> dict[str, Any]:
    """Return everything that the result depends on, as plain values."""
    return {"source": str(source.resolve()), "settings": _plain(settings), "seed": seed}


def _plain(settings: CaptureSettings) -> dict[str, Any]:
    """Return settings as they are read back from a JSON file."""
    return json.loads(json.dumps(dataclasses.asdict(settings)))


def _running(inputs: dict[str, Any]) -> dict[str, Any]:
    return {"format": FORMAT, "status": "running", "inputs": inputs}


def _finished(before: dict[str, Any], inputs: dict[str, Any], file: Path) -> Literal["no", "same", "other sphere"]:
    """Return whether a capture was finished with the same inputs, or with the same but for the person's sphere."""
    if before.get("status") != "done":
        return "no"
    known = before.get("inputs", {})
    try:
        earlier = _plain(captured_settings(before, file))
    except InputError:  # of another version
        return "no"
    if any(known.get(name) != inputs[name] for name in ("source", "seed")):
        return "no"
    automatic = {"centre": None, "radius": None}
    if earlier == inputs["settings"]:
        return "same"
    return "other sphere" if {**earlier, **automatic} == {**inputs["settings"], **automatic} else "no"


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
    posed, left_out = _posed(source, folder, settings, seed, progress)
    model, images, seen, sphere = posed.model, posed.images, posed.seen, chosen_sphere(settings)
    found, frame = None, load_frame(folder, model, settings)
    if frame is None:
        write_json(folder / FILE, _running(inputs))  # other cameras than before: the dataset in the folder is no longer valid
    if frame is None or sphere is None:
        if sphere is not None:
            progress.message("the sphere is in the frame of the capture without it, for which the object is cut out without it first")
        found = posed.cut_out(None)
        frame = posed.frame(found)
        frame.save(folder, model, settings)
    if sphere is not None:
        found = posed.cut_out(sphere.moved(np.linalg.inv(frame.similarity)))
    gains = exposure_gains(model, [one.view for one in images]) if seen is None else seen.gains
    turns = None if seen is None else light_rotations(images, frame.similarity)
    all_left_out = [*left_out, *model.left_out]
    result = CaptureResult(model, images, found, gains, frame.similarity, frame.true_size, all_left_out, turns, sphere)
    result = with_object_shown(result)
    _report_left_out(result.left_out[len(all_left_out) :], progress)
    for line in other_things(result.others):
        progress.message(line)
    write_json(folder / FILE, _running(inputs))
    _write(result, folder, {"format": FORMAT, "status": "done", "inputs": inputs, "source": str(source), **describe(result)})
    progress.message(f"capture: {len(result.images)} photographs, report in {folder / 'report.html'}")


def _posed(source: Path, folder: Path, settings: CaptureSettings, seed: int, progress: Progress) -> tuple[PosedPhotographs, list[LeftOut]]:
    """Return the photographs with the cameras that the dataset gives, or that are found, and those that are not usable."""
    if has_cameras(source, progress):
        if settings.turntable == "on" or settings.marker is not None:
            raise InputError(source, "has its cameras, to which a turntable or a marker can't be added", "name photographs without cameras")
        model = given_model(source)
        progress.message(f"the cameras of {len(model.posed)} photographs are those of the dataset")
        images = undistort_photographs(model, folder, settings.resolution, progress)
        return PosedPhotographs(model, images, None, settings, seed, progress), []
    photographs, left_out = read_photographs(source, folder, settings, progress)
    _report_left_out(left_out, progress)
    turntable = find_turntable(photographs, settings.turntable, progress)
    model = without_uncertain_poses(find_poses(photographs, folder, settings, seed, progress, turntable))
    _report_left_out(model.left_out, progress)
    images = undistort_photographs(model, folder, settings.resolution, progress)
    seen = None if turntable is None else SeenBackground.of(turntable, photographs, images)
    refined = refine_poses(model, images, {} if seen is None else seen.masks, seed, progress)
    widening = mask_widening(model)  # of the model before: its points are features, which tell how much texture there is
    return PosedPhotographs(refined.model, refined.images, seen, settings, seed, progress, widening, refined.dense), left_out


def _keep_edited_masks(folder: Path, progress: Progress) -> None:
    """Copy the masks that were edited since a capture was finished, since new ones take their place."""
    finished = (folder / FILE).stat().st_mtime_ns
    edited = [file for file in sorted((folder / "masks").glob("*.png")) if file.stat().st_mtime_ns > finished]
    for file in edited:
        (folder / EDITED).mkdir(exist_ok=True)
        shutil.copy2(file, folder / EDITED / file.name)
    if edited:
        progress.message(f"masks: {len(edited)} that were edited are replaced; copies are kept in {folder / EDITED}")


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
