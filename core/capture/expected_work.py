# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that photographs without cameras will need, known before a job starts: time and memory of their capture and reconstruction."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.summary import estimate_jobs, job_in_words
from ..errors import InputError
from ..io.image import image_size
from ..machine.job_time import corrected_seconds
from ..scene.camera import Camera
from ..scene.dataset import Bound, Dataset, View
from ..settings.schema import Settings
from .matching import MAX_EXHAUSTIVE, SIMILAR_PHOTOGRAPHS
from .photograph_files import CaptureFiles, find_photographs

# Seconds on two cores: captures of 48 photographs of 640 x 480 (72 s) and of 24 of 4000 x 3000 (238 s) on an idle machine, and 4 s more
# of the first since poses are refined.
START = 5.0
FEATURES = 0.9  # of the features, for each megapixel that is searched
PAIR = 0.075  # of matching two photographs of one megapixel; by the power 0.75 of the megapixels
DIFFERENT_PAIRS = 0.7  # fraction of the pairs of similar photographs that are not pairs of both
PHOTOGRAPH = 0.85  # of poses, dense points and masks, which are computed at one size, for each photograph
UNDISTORTION = 0.36  # for each megapixel of a full-size photograph
MEMORY = 1800 << 20  # peak of a capture, bytes: 1.3 and 1.7 GiB
USUAL_SIZE = (4000, 3000)  # where no header tells the size: of videos, HEIC and RAW
OBJECT_SHARE = 0.2  # of the pixels, until the masks tell
LOOKED_AT = 20  # photographs whose headers are read


def summarize_photographs(path: Path, settings: Settings) -> dict[str, Any]:
    """Return what is known about photographs without cameras, as plain values for JSON.

    Args:
        path: folder of photographs and videos, or a video.
        settings: whose capture is expected.

    Returns:
        path; format: "photographs"; photographs, videos: their numbers; capture: {seconds, memory (bytes), text} of finding cameras and
        object on the CPU; jobs: by preset, the same of the whole, capture and reconstruction; warnings; rows: [[name, text]] as in
        `describe_photographs`.

    Raises:
        InputError: if there is nothing to read.
    """
    files = find_photographs(path)
    count, size = _count(files, settings), _size(files)
    seconds = corrected_seconds(capture_seconds(settings, count, size))
    jobs = {
        name: job_in_words(job["seconds"] + seconds, max(job["memory"], MEMORY))
        for name, job in estimate_jobs(expected_dataset(path, settings, count, size)).items()
    }
    found = {"path": str(path), "format": "photographs", "photographs": len(files.photographs), "videos": len(files.videos)}
    found |= {"capture": job_in_words(seconds, MEMORY), "jobs": jobs, "warnings": files.notes}
    return found | {"rows": [list(row) for row in _rows(found, files)]}


def describe_photographs(found: dict[str, Any]) -> str:
    """Format the result of `summarize_photographs` as a table."""
    return "\n".join(f"{name:<10}{text}" for name, text in found["rows"])


def capture_seconds(settings: Settings, count: int, size: tuple[int, int]) -> float:
    """Estimate how long a capture takes on the machine of the constants above.

    Args:
        settings: of the job.
        count: number of photographs and frames of videos.
        size: width and height of a photograph in pixels.
    """
    capture, megapixels = settings.capture, size[0] * size[1] / 1e6
    searched = megapixels * min(1.0, capture.features / max(size)) ** 2
    pairs = count * (count - 1) / 2
    if capture.matching == "sequential" or (capture.matching == "auto" and count > MAX_EXHAUSTIVE):
        pairs = min(pairs, DIFFERENT_PAIRS * count * SIMILAR_PHOTOGRAPHS[capture.matching])
    per_photograph = FEATURES * searched + PHOTOGRAPH + UNDISTORTION * megapixels
    return START + count * per_photograph + pairs * PAIR * searched**0.75


def expected_dataset(path: Path, settings: Settings, count: int, size: tuple[int, int]) -> Dataset:
    """Return a dataset like the one that the capture will write, without colours, for the estimate of its reconstruction.

    Args:
        path: of the photographs.
        settings: of the job.
        count: number of photographs and frames of videos.
        size: width and height of a photograph in pixels.
    """
    ratio = max(1.0, max(size) / settings.data.resolution)
    width, height = max(1, round(size[0] / ratio)), max(1, round(size[1] / ratio))
    camera = Camera(width, height, float(width), float(width), width / 2, height / 2, np.eye(4))
    colour = np.broadcast_to(np.float32(0), (height, width, 3))
    alpha = np.broadcast_to(np.float32(OBJECT_SHARE), (height, width)) if settings.capture.masks else None
    views = [View(f"view{number}", camera, path, colour, alpha, reduction=ratio) for number in range(count)]
    test = views[:: settings.data.holdout] if count > settings.data.holdout else []
    train = [view for view in views if view not in test]
    return Dataset(path, "capture", train, test, Bound((0.0, 0.0, 0.0), 1.0), np.eye(4))


def _count(files: CaptureFiles, settings: Settings) -> int:
    return len(files.photographs) + settings.capture.frames * len(files.videos)


def _size(files: CaptureFiles) -> tuple[int, int]:
    """Return the most common size of the photographs, by their headers."""
    step = max(1, len(files.photographs) // LOOKED_AT)
    sizes: Counter[tuple[int, int]] = Counter()
    for photograph in files.photographs[::step]:
        try:
            sizes[image_size(photograph)] += 1
        except InputError:  # a kind whose header is not read here, or a damaged file, which the capture reports
            continue
    return sizes.most_common(1)[0][0] if sizes else USUAL_SIZE


def _rows(found: dict[str, Any], files: CaptureFiles) -> list[tuple[str, str]]:
    kinds = Counter(file.suffix.lower().lstrip(".") for file in (*files.photographs, *files.videos))
    return [
        ("dataset", found["path"]),
        ("cameras", "none; reconstruct finds them first, or capture alone"),
        ("files", ", ".join(f"{number} {kind}" for kind, number in kinds.most_common())),
        ("capture", f"{found['capture']['text']} on the CPU"),
        ("on CPU", "; ".join(f"{name} {job['text']}" for name, job in found["jobs"].items()) + ", the capture included"),
        *(("warning", line) for line in found["warnings"]),
    ]
