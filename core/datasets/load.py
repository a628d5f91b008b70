# SPDX-License-Identifier: GPL-3.0-or-later
"""Loading of datasets: parsing of the files, decoding, undistortion and reduction of the images, and the object's bound."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import InputError
from ..io.image import DecodedImage, on_black, read_depth_mask, read_image, read_mask, reduce_image, reduce_mask
from ..io.safe_paths import inside
from ..machine.thread_pool import run_reported
from ..progress.protocol import Progress, Silent
from ..scene.camera import Camera
from ..scene.dataset import Dataset, View
from ..settings.schema import DataSettings
from .bound import object_bound
from .camera_light import with_camera_light
from .exposure import even_exposures
from .format_detection import parse_dataset
from .parsed_dataset import MINIMUM_VIEWS, Frame, ParsedDataset
from .prepared_frames import PreparedFrame, decoding_threads, is_reduction, prepare_frames
from .undistort import undistort, undistort_mask

OPAQUE = 1 - 1.5 / 255
SMALLEST_SIDE = 8
FULL_SIZE = 1 << 20  # a resolution that reduces no image


def load_dataset(path: Path, settings: DataSettings = DataSettings(), progress: Progress = Silent()) -> Dataset:  # noqa: B008 (immutable)
    """Load a dataset of any known format (docs/datasets.md).

    Images are undistorted and reduced to `settings.resolution`; single broken images are left out with a warning.

    Args:
        path: a folder, a file of cameras, or the folder of a COLMAP model; `format_detection.parse_dataset` says which of several
            descriptions in a folder is read.
        settings: settings of the dataset.
        progress: reports the images, and cancels.

    Raises:
        InputError: if the dataset is missing, damaged or unusable.
        Cancelled: if the user stopped the work.
    """
    parsed = _parse_dataset(path, settings)
    warnings = list(parsed.warnings)
    _report_missing_images(parsed, warnings)
    train, test = (_with_image(frames) for frames in parsed.split(settings))
    if len(train) < MINIMUM_VIEWS:
        raise InputError(parsed.source, f"has {len(train)} training views, at least {MINIMUM_VIEWS} are needed")
    centres = np.stack([f.to_world[:3, 3] for f in train])
    if np.ptp(centres, axis=0).max() <= 1e-6 * np.abs(centres).max():
        raise InputError(parsed.source, "has all cameras at one place", "depth needs photographs taken from different places")
    prepared, prepared_test = prepare_frames(train, settings, warnings), prepare_frames(test, settings, warnings)
    mask_error = parsed.mask_error if settings.mask_error is None else settings.mask_error
    images = _decode([*prepared, *prepared_test], settings, progress, mask_error)
    count = len(prepared)
    views, test_views = _usable(images[:count], MINIMUM_VIEWS, warnings), _usable(images[count:], 0, warnings)
    views, test_views = _normalise_alpha(views, test_views, warnings)
    even = even_exposures([*views, *test_views], parsed.points, settings.exposure, warnings)
    views, test_views = even[: len(views)], even[len(views) :]
    bound = object_bound(parsed, views, settings, warnings)
    views, test_views, lit_from_camera = with_camera_light(views, test_views, bound, settings.light, warnings)
    if parsed.surroundings is not None and parsed.surroundings.has_ground:
        bound = replace(bound, floor=0.0)
    lenses = sorted({str(p.frame.lens) for p in prepared})
    novel = Counter(f.light for f in _with_image(parsed.novel) if f.light is not None)
    about = (parsed.points, warnings, lenses, dict(novel), parsed.surroundings, lit_from_camera)
    return Dataset(path, parsed.format, views, test_views, bound, parsed.to_world, *about)


def load_dataset_cameras(
    path: Path,
    split: str | None = None,
    settings: DataSettings = DataSettings(),  # noqa: B008 (immutable)
) -> tuple[list[tuple[str, Camera]], np.ndarray]:
    """Load the cameras of a dataset, equal to those of `load_dataset`, without decoding any image.

    Images need not be on disk if none of the split is: their cameras then have the stated size, or that of the other split's images.

    Args:
        path: the dataset, as for `load_dataset`.
        split: "train", "test", "all", or None: the dataset's own test split if it names one, else all views.
        settings: settings of the dataset.

    Returns:
        (view name, camera) of each view, and the similarity `to_world` (4, 4) from the dataset's own frame to the world.

    Raises:
        InputError: if the dataset is missing or damaged, or the split does not exist or is empty.
    """
    if split not in (None, "train", "test", "all"):
        raise InputError(f"{path}:{split}", "no such split", "use train, test or all")
    parsed = _parse_dataset(path, settings)
    train, test = parsed.split(settings)
    default = parsed.train if parsed.test is None else test
    frames = {"train": train, "test": test, "all": [*train, *test], None: default}[split]
    if not frames:
        raise InputError(parsed.source, f"has no {split or 'test'} views")
    return [(p.name, p.camera) for p in prepare_frames(_with_image(frames) or frames, settings, [])], parsed.to_world


def full_size_views(dataset: Dataset, settings: DataSettings) -> Iterator[tuple[str, View]]:
    """Yield (split, view) of a dataset in order, with the cameras of the unreduced images.

    Only images with lens distortion are decoded, one after another: the others match their cameras as they are, and `colour` is empty.

    Args:
        dataset: the dataset.
        settings: the settings that it was loaded with.

    Raises:
        InputError: if an image was removed or changed since.
    """
    full = replace(settings, resolution=FULL_SIZE)
    frames = _parse_dataset(dataset.path, full).split(settings)
    for split, listed, views in zip(("train", "test"), frames, (dataset.train, dataset.test), strict=True):
        usable = {view.name for view in views}  # the others were left out with a warning
        for prepared in prepare_frames(_with_image(listed), full, []):
            if prepared.name not in usable or prepared.frame.image is None:
                continue
            plain = View(prepared.name, prepared.camera, prepared.frame.image, np.empty((0, 0, 3), np.float32), None)
            view = _view(prepared, masks=False) if prepared.frame.lens.distorted else plain
            if isinstance(view, InputError):
                raise view
            yield split, view


def full_size_frames(
    path: Path, settings: DataSettings, resolution: int = FULL_SIZE, split: Literal["train", "declared"] = "train"
) -> list[PreparedFrame]:
    """Return the frames of a dataset whose images are on the disk, with their lenses at full size; none is decoded.

    Args:
        path: the dataset, as for `load_dataset`.
        settings: the settings that it was loaded with.
        resolution: longest side of the images, pixels.
        split: training frames by the settings, or all that the dataset does not declare as test views.

    Raises:
        InputError: if the dataset is missing or damaged.
    """
    parsed = _parse_dataset(path, settings)
    frames = parsed.split(settings)[0] if split == "train" else parsed.train
    return prepare_frames(_with_image(frames), replace(settings, resolution=resolution), [])


def load_novel_views(dataset: Dataset, settings: DataSettings, progress: Progress = Silent()) -> list[View]:  # noqa: B008 (immutable)
    """Load the views of a dataset's object under other lights (each view's `light`), with which relit images are compared.

    Args:
        dataset: the dataset, whose `train` and `test` do not contain these views.
        settings: the settings that it was loaded with.
        progress: reports the images and warnings, and cancels.

    Returns:
        The views in the world of the dataset; empty if it has none.

    Raises:
        InputError: if a file is damaged.
    """
    parsed, warnings = _parse_dataset(dataset.path, settings), []
    views = _usable(_decode(prepare_frames(_with_image(parsed.novel), settings, warnings), settings, progress), 0, warnings)
    for line in warnings:
        progress.message(f"warning: {line}")
    return views


def _parse_dataset(path: Path, settings: DataSettings) -> ParsedDataset:
    if settings.resolution < SMALLEST_SIDE:
        raise InputError("data.resolution", f"is {settings.resolution}", f"give {SMALLEST_SIDE} pixels or more")
    parsed = parse_dataset(path, settings)
    for frame in (*parsed.train, *(parsed.test or [])):  # views under other lights may be next to the folder; their readers check them
        for file in filter(None, (frame.image, frame.mask)):
            inside(file, parsed.root)
    return parsed


def _with_image(frames: list[Frame]) -> list[Frame]:
    return [f for f in frames if f.image is not None]


def _report_missing_images(parsed: ParsedDataset, warnings: list[str]) -> None:
    """Warn about images that are listed but missing; raise InputError if all training images are missing."""
    for kind, frames in (("training", parsed.train), ("test", parsed.test or [])):
        missing = [f for f in frames if f.image is None]
        if missing and len(missing) == len(frames) and kind == "training":
            raise InputError(
                parsed.source, f"none of its {len(frames)} images exists", f"check its paths; the first is {missing[0].listed}"
            )
        if missing:
            what = f"{len(missing)} of {len(frames)} {kind} images are missing (first: {missing[0].listed})"
            warnings.append(f"{parsed.source.name}: {what}; left out")


def _decode(prepared: list[PreparedFrame], settings: DataSettings, progress: Progress, mask_error: float = 0.0) -> list[View | InputError]:
    """Decode the views in order; the error takes the place of a view that can't be used."""
    progress.phase("read images", len(prepared))
    return run_reported(
        lambda one: _view(one, settings.masks, mask_error), prepared, decoding_threads(), progress, "stopped while reading images"
    )


def _view(prepared: PreparedFrame, masks: bool, mask_error: float = 0.0) -> View | InputError:
    """Decode a view, or return the error that makes it unusable; without `masks`, alpha is composited over black and mask files ignored."""
    frame, size = prepared.frame, prepared.lens.size
    try:
        assert frame.image is not None
        if min(size) < SMALLEST_SIDE:
            what = f"would be used at {size[0]}x{size[1]} pixels"
            raise InputError(frame.image, what, f"at least {SMALLEST_SIDE} pixels a side are needed; raise data.resolution")
        return view_of(prepared, read_image(frame.image), masks, mask_error)
    except InputError as error:
        return error


def view_of(prepared: PreparedFrame, image: DecodedImage, masks: bool, mask_error: float = 0.0) -> View:
    """Return the view of a decoded image: reduced, undistorted and masked.

    Args:
        prepared: its frame.
        image: as it was read.
        masks: use its mask file or alpha channel; False: composite alpha over black and ignore mask files.
        mask_error: error of mask files, as a fraction of the longest side.

    Raises:
        InputError: if the mask is damaged or leaves nothing.
    """
    frame, size, full = prepared.frame, prepared.lens.size, max(image.size)
    assert frame.image is not None
    if frame.mask is not None and masks:  # a mask file replaces an alpha channel, and keeps the colour around the object
        mask = undistort_mask(_mask(frame, image.size, size), prepared.lens)
        opaque = reduce_image(DecodedImage(image.colour, None), *size)
        image = DecodedImage(undistort(opaque, prepared.lens).colour, mask)
    else:
        image = reduce_image(image, *size)
        image = undistort(image if masks else on_black(image), prepared.lens)
    if image.alpha is not None and image.alpha.max() < 0.5:
        raise InputError(frame.mask if frame.mask and masks else frame.image, "is transparent everywhere")
    error = mask_error * max(size) if masks and frame.mask is not None else 0.0  # an alpha channel may hide the colours beside the object
    about = (frame.lens.distorted, frame.light, frame.gain, error)
    more = {"reduction": full / max(size), "light_rotation": frame.light_rotation}
    return View(prepared.name, prepared.camera, frame.image, image.colour, image.alpha, *about, **more)


def _mask(frame: Frame, image: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """Read a frame's mask (H, W) at the size that its image is used at; a full-size mask may belong to a reduced image."""
    assert frame.mask is not None
    mask = read_mask(frame.mask) if frame.far is None else read_depth_mask(frame.mask, frame.far)
    full = mask.shape[1], mask.shape[0]
    if full != image and not is_reduction(full, image):
        raise InputError(frame.mask, f"is {full[0]}x{full[1]} but its image is {image[0]}x{image[1]}")
    return reduce_mask(mask, *size)


def _usable(images: list[View | InputError], needed: int, warnings: list[str]) -> list[View]:
    """Return the views without the unusable ones, each with a warning.

    If views are `needed`, InputError is raised where fewer are left or half of the images or more are unusable.
    """
    errors = [p for p in images if isinstance(p, InputError)]
    views = [p for p in images if isinstance(p, View)]
    if errors and needed and (len(errors) * 2 >= len(images) or len(views) < needed):
        raise InputError(errors[0].where, errors[0].what, f"{len(errors)} of {len(images)} images can't be used")
    warnings.extend(f"{e}; left out" for e in errors)
    return views


def _normalise_alpha(train: list[View], test: list[View], warnings: list[str]) -> tuple[list[View], list[View]]:
    """Drop alpha channels that are opaque everywhere, those of training views if all are; else warn about these without alpha."""
    if all(_is_opaque(v) for v in train):
        return [replace(v, alpha=None) for v in train], [replace(v, alpha=None) if _is_opaque(v) else v for v in test]
    bare = [v.name for v in train if v.alpha is None]
    if bare:
        warnings.append(f"{len(bare)} of {len(train)} views have no mask (first: {bare[0]})")
    return train, test


def _is_opaque(view: View) -> bool:
    """Return True for a view without alpha, or one that is opaque everywhere."""
    return view.alpha is None or bool(view.alpha.min() > OPAQUE)
