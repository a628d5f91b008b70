# SPDX-License-Identifier: GPL-3.0-or-later
"""From a path to a dataset: what kind it is, its cameras, its pixels, its object."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..errors import Cancelled, InputError
from ..io.image import DecodedImage, image_size, on_black, read_depth_mask, read_image, read_mask, reduce_image, reduce_mask
from ..io.safe_paths import inside
from ..progress.protocol import Progress, Silent
from ..scene.camera import Camera
from ..scene.dataset import Dataset, View
from ..settings.schema import DataSettings
from .bound import object_bound
from .format_detection import parse_dataset
from .parsed_dataset import MINIMUM_VIEWS, Frame, Lens, ParsedDataset, view_names
from .undistort import pinhole, undistort, undistort_mask

OPAQUE = 1 - 1.5 / 255
SMALLEST_SIDE = 8
FULL_SIZE = 1 << 20  # a resolution that reduces no image

In = TypeVar("In")
Out = TypeVar("Out")


@dataclass(frozen=True, eq=False)
class _Shot:
    """A frame with its view name and the lens fitted to the size that the image is used at."""

    frame: Frame
    name: str
    lens: Lens
    camera: Camera


def load_dataset(path: Path, settings: DataSettings = DataSettings(), progress: Progress = Silent()) -> Dataset:  # noqa: B008 (immutable)
    """Read a dataset of any known format (docs/datasets.md): a folder, a file of cameras, or the folder of a COLMAP model.

    Images are undistorted and reduced to `settings.resolution`. `detect.read_capture` says which of several descriptions is read.
    Raises InputError on bad input; single broken images are left out with a warning.
    """
    capture = _parse_dataset(path, settings)
    warnings = list(capture.warnings)
    _check_on_disk(capture, warnings)
    train, test = (_present(frames) for frames in capture.split(settings))
    if len(train) < MINIMUM_VIEWS:
        raise InputError(capture.source, f"has {len(train)} views to learn from, at least {MINIMUM_VIEWS} are needed")
    centres = np.stack([f.to_world[:3, 3] for f in train])
    if np.ptp(centres, axis=0).max() <= 1e-6 * np.abs(centres).max():
        raise InputError(capture.source, "has all cameras at one place", "depth needs images from different places")
    shots, tests = _shots(train, settings, warnings), _shots(test, settings, warnings)
    images = _decode([*shots, *tests], settings, progress)
    views, checks = _usable(images[: len(shots)], MINIMUM_VIEWS, warnings), _usable(images[len(shots) :], 0, warnings)
    views, checks = _settle_alpha(views, checks, warnings)
    bound = object_bound(capture, views, settings, warnings)
    lenses = sorted({str(s.frame.lens) for s in shots})
    novel = Counter(f.light for f in _present(capture.novel) if f.light is not None)
    return Dataset(path, capture.format, views, checks, bound, capture.to_world, capture.points, warnings, lenses, dict(novel))


def load_dataset_cameras(
    path: Path,
    split: str | None = None,
    settings: DataSettings = DataSettings(),  # noqa: B008 (immutable)
) -> tuple[list[tuple[str, Camera]], np.ndarray]:
    """(view names and cameras, (4, 4) `to_world`) as `load_dataset` gives them, without decoding a pixel.

    `split` is "train", "test", "all", or None: the dataset's own test split where it names one, else every view. Images need not be
    on disk where none of the split is; their cameras then have the stated size, or that of the other split's images.
    Raises InputError on bad input and for a split without views.
    """
    if split not in (None, "train", "test", "all"):
        raise InputError(f"{path}:{split}", "no such split", "use train, test or all")
    capture = _parse_dataset(path, settings)
    train, test = capture.split(settings)
    default = capture.train if capture.test is None else test
    frames = {"train": train, "test": test, "all": [*train, *test], None: default}[split]
    if not frames:
        raise InputError(capture.source, f"has no {split or 'test'} views")
    return [(s.name, s.camera) for s in _shots(_present(frames) or frames, settings, [])], capture.to_world


def full_size_views(dataset: Dataset, settings: DataSettings) -> Iterator[tuple[str, View]]:
    """(split, view) of a dataset that was read with these settings, in order, with the cameras of the unreduced images.

    Only images with lens distortion are decoded, one after another: the others fit their cameras as they are, and `colour` is empty.
    Raises InputError where an image has gone or changed since.
    """
    full = replace(settings, resolution=FULL_SIZE)
    frames = _parse_dataset(dataset.path, full).split(settings)
    for split, listed, views in zip(("train", "test"), frames, (dataset.train, dataset.test), strict=True):
        kept = {view.name for view in views}  # the others could not be used, which has been told
        for shot in _shots(_present(listed), full, []):
            if shot.name not in kept or shot.frame.image is None:
                continue
            plain = View(shot.name, shot.camera, shot.frame.image, np.empty((0, 0, 3), np.float32), None)
            view = _view(shot, masks=False) if shot.frame.lens.distorted else plain
            if isinstance(view, InputError):
                raise view
            yield split, view


def load_novel_views(dataset: Dataset, settings: DataSettings, progress: Progress = Silent()) -> list[View]:  # noqa: B008 (immutable)
    """The views of a dataset's object under other lights (each view's `light`), in the world of the dataset; empty where it has none.

    They are no part of `train` and `test`: relit images are compared with them. Raises InputError on bad input.
    """
    capture, warnings = _parse_dataset(dataset.path, settings), []
    views = _usable(_decode(_shots(_present(capture.novel), settings, warnings), settings, progress), 0, warnings)
    for line in warnings:
        progress.message(f"warning: {line}")
    return views


def _parse_dataset(path: Path, settings: DataSettings) -> ParsedDataset:
    if settings.resolution < SMALLEST_SIDE:
        raise InputError("data.resolution", f"is {settings.resolution}", f"give {SMALLEST_SIDE} pixels or more")
    capture = parse_dataset(path, settings)
    for frame in (*capture.train, *(capture.test or [])):  # those under other lights may lie beside, which their readers check
        for file in filter(None, (frame.image, frame.mask)):
            inside(file, capture.root)
    return capture


def _present(frames: list[Frame]) -> list[Frame]:
    return [f for f in frames if f.image is not None]


def _check_on_disk(capture: ParsedDataset, warnings: list[str]) -> None:
    """Tell of images that are listed but not there; without any to learn from there is no dataset."""
    for kind, frames in (("training", capture.train), ("test", capture.test or [])):
        missing = [f for f in frames if f.image is None]
        if missing and len(missing) == len(frames) and kind == "training":
            raise InputError(capture.source, f"none of its {len(frames)} images exists", f"looked for {missing[0].listed} and so on")
        if missing:
            first = f"{len(missing)} of {len(frames)} {kind} images are missing (first: {missing[0].listed})"
            warnings.append(f"{capture.source.name}: {first}; left out")


def _shots(frames: list[Frame], settings: DataSettings, warnings: list[str]) -> list[_Shot]:
    """Names and final cameras; the headers of the images are read, and checked against the cameras."""
    sizes = _in_threads(_measured, frames)
    fitted = _fit(frames, sizes, warnings)
    shots = []
    for frame, name, lens in zip(frames, view_names([f.listed for f in frames]), fitted, strict=True):
        lens = _reduced(lens, settings.resolution)
        try:
            p = pinhole(lens)
        except InputError as error:
            raise InputError(frame.image or frame.listed, f"{error.where} {error.what}", error.fix) from error
        shots.append(_Shot(frame, name, lens, Camera(p.width, p.height, p.fx, p.fy, p.cx, p.cy, frame.to_world)))
    return shots


def _measured(frame: Frame) -> tuple[int, int]:
    """Size of the frame's image; the camera's where the image is missing or broken, which is told when it is decoded."""
    try:
        return image_size(frame.image) if frame.image else frame.lens.size
    except InputError:
        return frame.lens.size


def _fit(frames: list[Frame], sizes: list[tuple[int, int]], warnings: list[str]) -> list[Lens]:
    """Each frame's lens at its image's size. A size other than the camera's is right only where all images of that camera are
    the same uniform reduction; anything else means that image and camera don't belong together."""
    by_lens: dict[Lens, set[tuple[int, int]]] = {}
    for frame, size in zip(frames, sizes, strict=True):
        by_lens.setdefault(frame.lens, set()).add(size)
    for frame, size in zip(frames, sizes, strict=True):
        if size != frame.lens.size and (len(by_lens[frame.lens]) > 1 or not _is_reduction(frame.lens.size, size)):
            camera = f"{frame.lens.width}x{frame.lens.height}"
            raise InputError(frame.image or frame.listed, f"is {size[0]}x{size[1]} but its camera is {camera}")
    for lens, found in by_lens.items():
        size = next(iter(found))
        if size != lens.size:
            line = f"images are {size[0]}x{size[1]}, their camera {lens.width}x{lens.height}: intrinsics are scaled"
            warnings.extend([line] if line not in warnings else [])
    return [f.lens.resized(*s) if s != f.lens.size else f.lens for f, s in zip(frames, sizes, strict=True)]


def _is_reduction(full: tuple[int, int], small: tuple[int, int]) -> bool:
    """True where `small` is `full` divided by one number, each side rounded in whatever way; a few pixels less is a crop."""
    smaller = 1.1 * small[0] <= full[0] and 1.1 * small[1] <= full[1]
    return smaller and abs(small[0] * full[1] - small[1] * full[0]) <= max(full)


def _reduced(lens: Lens, resolution: int) -> Lens:
    scale = resolution / max(lens.size)
    return lens if scale >= 1 else lens.resized(max(1, round(lens.width * scale)), max(1, round(lens.height * scale)))


def _decode(shots: list[_Shot], settings: DataSettings, progress: Progress) -> list[View | InputError]:
    """Views in order; the error in place of one that can't be used."""
    progress.phase("read images", len(shots))
    views = []
    with ThreadPoolExecutor(_threads()) as pool:
        for view in pool.map(lambda shot: _view(shot, settings.masks), shots):
            views.append(view)
            progress.step(len(views))
            if progress.cancelled:
                pool.shutdown(cancel_futures=True)
                raise Cancelled("stopped while reading images")
    return views


def _view(shot: _Shot, masks: bool) -> View | InputError:
    frame, size = shot.frame, shot.lens.size
    try:
        assert frame.image is not None
        if min(size) < SMALLEST_SIDE:
            raise InputError(
                frame.image, f"is used at {size[0]}x{size[1]} pixels, {SMALLEST_SIDE} a side are the least that show an object"
            )
        image = read_image(frame.image)
        if frame.mask is not None and masks:  # a mask file takes the place of an alpha channel, and leaves the colour around the object
            mask = undistort_mask(_mask(frame, image.size, size), shot.lens)
            opaque = reduce_image(DecodedImage(image.colour, None), *size)
            image = DecodedImage(undistort(opaque, shot.lens).colour, mask)
        else:
            image = reduce_image(image, *size)
            image = undistort(image if masks else on_black(image), shot.lens)
        if image.alpha is not None and image.alpha.max() < 0.5:
            raise InputError(frame.mask if frame.mask and masks else frame.image, "is transparent everywhere")
    except InputError as error:
        return error
    return View(shot.name, shot.camera, frame.image, image.colour, image.alpha, frame.lens.distorted, frame.light)


def _mask(frame: Frame, image: tuple[int, int], size: tuple[int, int]) -> np.ndarray:
    """(H, W) the mask at the size its image is used at; a full-size mask may go with a reduced image."""
    assert frame.mask is not None
    mask = read_mask(frame.mask) if frame.far is None else read_depth_mask(frame.mask, frame.far)
    full = mask.shape[1], mask.shape[0]
    if full != image and not _is_reduction(full, image):
        raise InputError(frame.mask, f"is {full[0]}x{full[1]} but its image is {image[0]}x{image[1]}")
    return reduce_mask(mask, *size)


def _usable(images: list[View | InputError], needed: int, warnings: list[str]) -> list[View]:
    """The views without the broken ones: one broken image is an accident, but where views are `needed`, many are a broken dataset."""
    errors = [p for p in images if isinstance(p, InputError)]
    views = [p for p in images if isinstance(p, View)]
    if errors and needed and (len(errors) * 2 >= len(images) or len(views) < needed):
        raise InputError(errors[0].where, errors[0].what, f"{len(errors)} of {len(images)} images can't be used")
    warnings.extend(f"{e}; left out" for e in errors)
    return views


def _settle_alpha(train: list[View], test: list[View], warnings: list[str]) -> tuple[list[View], list[View]]:
    """Alpha that is opaque everywhere tells nothing and is dropped; views without any among views with some are told."""
    if all(v.alpha is None or v.alpha.min() > OPAQUE for v in train):
        return [replace(v, alpha=None) for v in train], [replace(v, alpha=None) for v in test]
    bare = [v.name for v in train if v.alpha is None]
    if bare:
        warnings.append(f"{len(bare)} of {len(train)} views have no mask (first: {bare[0]})")
    return train, test


def _threads() -> int:
    return min(8, os.cpu_count() or 1)


def _in_threads(work: Callable[[In], Out], items: Iterable[In]) -> list[Out]:
    with ThreadPoolExecutor(_threads()) as pool:
        return list(pool.map(work, items))
