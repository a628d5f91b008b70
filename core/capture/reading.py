# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading of a capture: photographs and frames of videos to upright copies with masks, less those that are not usable."""

from __future__ import annotations

import warnings
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from ..datasets.parsed_dataset import MINIMUM_VIEWS, view_names
from ..errors import Cancelled, InputError
from ..io.atomic import write_atomic
from ..machine.thread_pool import thread_count
from ..progress.protocol import Progress
from ..settings.schema import CaptureSettings
from .copies import Copy, Record, copy_path, copy_photograph, encoded, mask_path, stamp_of
from .exif import lens_key
from .given_masks import write_given_mask
from .mask_files import find_masks, mask_key
from .photograph import LeftOut, Photograph
from .photograph_files import COPIES, FIX, GIVEN_MASKS, CaptureFiles, find_photographs
from .usable import Appearance, read_appearance, unusable
from .video import VideoFrame, sharp_frames

PHASE = "read photographs"
THREADS = 4  # photographs decoded at a time, at most: one of 50 megapixels takes half a gigabyte
WRITE_EVERY = 20  # photographs after which the record is written

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Prepared:
    """Photograph with its copy.

    Attributes:
        photograph: photograph with its mask.
        copy: entry of the record.
        appearance: measures of the copy.
        mask: entry of the record on its mask; None where no mask file was used.
        notes: lines for the user, without the photograph's name.
    """

    photograph: Photograph
    copy: Copy
    appearance: Appearance
    mask: list | None
    notes: tuple[str, ...]


def read_photographs(path: Path, folder: Path, settings: CaptureSettings, progress: Progress) -> tuple[list[Photograph], list[LeftOut]]:
    """Read a capture: write upright copies of its photographs and frames, and select the usable ones.

    Copies whose source has not changed since they were made are taken as they are.

    Args:
        path: folder of photographs and videos, or a video; nothing is written there.
        folder: folder of the capture's results; `photographs/`, `given_masks/` and `photographs.json` are written into it.
        settings: number of frames of each video.
        progress: receives the phase, and may cancel.

    Returns:
        Usable photographs in natural order, and those left out.

    Raises:
        InputError: if fewer than three photographs are usable.
        Cancelled: once the user stops the job; finished copies stay.
    """
    files = find_photographs(path)
    for name in (COPIES, GIVEN_MASKS):
        (folder / name).mkdir(parents=True, exist_ok=True)
    progress.phase(PHASE, len(files.photographs) + settings.frames * len(files.videos))
    for note in files.notes:
        progress.message(note)
    reading = Reading(files, find_masks(path) if path.is_dir() else {}, Record(folder), progress)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of damaged EXIF
        prepared = reading.run(settings.frames)
    return _selected(path, prepared, reading.left_out, progress)


def _selected(path: Path, prepared: list[Prepared], unread: list[LeftOut], progress: Progress) -> tuple[list[Photograph], list[LeftOut]]:
    """Select the usable photographs."""
    photographs = [p.photograph for p in prepared]
    poor, lines = unusable([p.name for p in photographs], [p.lens for p in photographs], [p.appearance for p in prepared])
    for line in lines:
        progress.message(line)
    left_out = [*unread, *poor]
    names = {one.name for one in poor}
    chosen = [p for p in photographs if p.name not in names]
    if len(chosen) < MINIMUM_VIEWS:
        reasons = f"; left out: {left_out[0].name} ({left_out[0].reason})" if left_out else ""
        raise InputError(path, f"has {len(chosen)} usable photographs, fewer than {MINIMUM_VIEWS}{reasons}", FIX)
    return chosen, left_out


class Reading:
    """Reading of all files of a capture.

    Args:
        files: photographs and videos.
        masks: mask file by `mask_key`.
        record: record of the copies in the capture's folder.
        progress: receives the phase, and may cancel.
    """

    def __init__(self, files: CaptureFiles, masks: dict[str, Path], record: Record, progress: Progress) -> None:
        self._files, self._masks, self._record, self._progress = files, masks, record, progress
        self._folder, self._steps = record.folder, 0
        self._notes: dict[str, list[str]] = defaultdict(list)
        self.left_out: list[LeftOut] = []

    def run(self, frames: int) -> list[Prepared]:
        """Read everything.

        Args:
            frames: number of frames taken of each video.
        """
        self._record.write()  # marks the folder of copies, which may lie among the photographs
        files = [*self._files.photographs, *self._files.videos]
        names = view_names([f.relative_to(self._files.root).with_suffix(".jpg").as_posix() for f in files])
        photographs = list(zip(files, names, strict=True))[: len(self._files.photographs)]
        try:
            with ThreadPoolExecutor(min(thread_count(), THREADS), thread_name_prefix="photographs") as pool:
                prepared = self._collected(in_order(pool, self._photograph, photographs, THREADS))
                for video, name in zip(self._files.videos, names[len(photographs) :], strict=True):
                    prepared += self._video(pool, video, name, frames)
        finally:
            self._record.write()
        for note, about in self._notes.items():
            self._progress.message(f"{about[0]}{f' and {len(about) - 1} more' if len(about) > 1 else ''}: {note}")
        return prepared

    def _collected(self, results: Iterator[Prepared | LeftOut]) -> list[Prepared]:
        """Collect results into the record; check for cancellation after each."""
        prepared = []
        for result in results:
            if isinstance(result, LeftOut):
                self.left_out.append(result)
            else:
                prepared.append(result)
                self._note(result)
            self._steps += 1
            self._progress.step(self._steps)
            if self._steps % WRITE_EVERY == 0:
                self._record.write()
            if self._progress.cancelled:
                raise Cancelled(f"stopped after {self._steps} photographs were read")
        return prepared

    def _note(self, result: Prepared) -> None:
        """Add a photograph to the record, and its notes to those for the user."""
        name = result.photograph.name
        self._record.copies[name] = result.copy
        self._record.masks.pop(name, None)
        if result.mask is not None:
            self._record.masks[name] = result.mask
        for note in result.notes:
            self._notes[note].append(name)

    def _photograph(self, job: tuple[Path, str]) -> Prepared | LeftOut:
        """Copy a photograph, unless its copy is valid."""
        source, name = job
        try:
            copy = self._record.valid(name, source) or copy_photograph(source, name, self._folder)
            return self._prepared(name, source, copy, mask_key(source, self._files.root))
        except InputError as error:
            return LeftOut(name, f"{error.what}{f'; {error.fix}' if error.fix else ''}")

    def _video(self, pool: ThreadPoolExecutor, video: Path, name: str, count: int) -> list[Prepared]:
        """Read the frames of a video, unless all their copies are valid."""
        key, stamp, before = mask_key(video, self._files.root), stamp_of(video), self._steps
        known = self._record.videos.get(key, [])
        numbers = known[3] if known[:3] == [*stamp, count] else []
        valid = [self._record.valid(_frame_name(name, n), video) for n in numbers]
        frames: Iterable[VideoFrame | Copy]
        frames = [c for c in valid if c] if numbers and all(valid) else sharp_frames(video, count, self._progress)
        try:
            prepared = self._collected(in_order(pool, lambda f: self._frame(video, name, key, stamp, f), frames, THREADS))
        except InputError as error:
            self.left_out.append(LeftOut(video.name, f"{error.what}{f'; {error.fix}' if error.fix else ''}"))
            return []
        self._record.videos[key] = [*stamp, count, [p.copy.number for p in prepared]]
        self._steps = before + count
        self._progress.step(self._steps)
        return prepared

    def _frame(self, video: Path, name: str, key: str, stamp: tuple[int, int], frame: VideoFrame | Copy) -> Prepared | LeftOut:
        """Write a frame, unless it is a copy already."""
        title = _frame_name(name, frame.number)
        if isinstance(frame, VideoFrame):
            height, width = frame.colour.shape[:2]
            lens = lens_key(f"video {name}", width, height)
            copy = Copy(stamp, ".jpg", width, height, lens, None, None, frame.turned, False, False, number=frame.number)
            write_atomic(copy_path(self._folder, title, ".jpg"), encoded(frame.colour, ".jpg"))
        else:
            copy = frame
        return self._prepared(title, video, copy, _frame_name(key, frame.number))

    def _prepared(self, name: str, source: Path, copy: Copy, key: str) -> Prepared:
        """Return a photograph with its mask and measures."""
        file, target, notes = self._masks.get(key), mask_path(self._folder, name), copy.notes
        entry = None if file is None else [str(file), *stamp_of(file), *copy.stamp]
        old = self._record.masks.get(name)
        if entry != old or (entry and not target.is_file()):
            if file is None and copy.alpha:  # the mask file is gone: the alpha channel counts again
                copy = copy_photograph(source, name, self._folder)
            elif file is not None:
                entry, notes = self._with_mask(file, copy, target, entry, notes)
        if entry is None and not copy.alpha:
            target.unlink(missing_ok=True)
        photograph = copy.photograph(name, source, self._folder)
        return Prepared(photograph, copy, read_appearance(photograph.image), entry, notes)

    def _with_mask(
        self, file: Path, copy: Copy, target: Path, entry: list | None, notes: tuple[str, ...]
    ) -> tuple[list | None, tuple[str, ...]]:
        """Write a mask; one that can't be used is noted."""
        try:
            write_given_mask(file, (copy.width, copy.height), copy.orientation, target)
            return entry, notes
        except InputError as error:
            return None, (*notes, f"the mask {error.what}; it is not used")


def _frame_name(name: str, number: int) -> str:
    """Return the name of a video's frame."""
    return f"{name}_f{number:06}"


def in_order(pool: ThreadPoolExecutor, function: Callable[[Item], Result], items: Iterable[Item], ahead: int) -> Iterator[Result]:
    """Yield the results of a function on threads in the order of the items, of which at most `ahead` are in work.

    Args:
        pool: threads.
        function: called with one item.
        items: drawn one at a time.
        ahead: number of items in work.
    """
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
