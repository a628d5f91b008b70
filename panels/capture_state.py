# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of photographs and captures as panels show them, looked at every two seconds at most however often panels are drawn."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..irgspp_addon.importer.capture_file import CaptureSummary, read_capture
from ..irgspp_addon.importer.photographs import BarePhotographs, find_bare_photographs, sample_photographs
from ..irgspp_addon.importer.photographs import problem_of as find_problem

CHECK_SECONDS = 2.0  # between two looks at the same folder

_known: dict[tuple[Any, Path], tuple[float, Any]] = {}  # by function and folder: when it was looked at, and the result


def capture_of(folder: Path | None) -> CaptureSummary | None:
    """Return the summary of a captured dataset; None for other folders."""
    return _look(read_capture, folder)


def bare_photographs(folder: Path | None) -> BarePhotographs | None:
    """Return the photographs of a folder without cameras, or a video; None for anything else."""
    return _look(find_bare_photographs, folder)


def cameras_missing(folder: Path, capture: CaptureSummary | None) -> bool:
    """Return True for photographs whose cameras must be found: bare ones, or a capture that is not finished.

    Args:
        folder: of the photographs, or a video.
        capture: summary of its capture.json; None without one.
    """
    return capture.status == "running" if capture is not None else bare_photographs(folder) is not None


def problem_of(folder: Path | None) -> str:
    """Return what the chosen folder lacks, in a sentence; "" where nothing is known to be lacking, or none is chosen."""
    return _look(find_problem, folder) or ""


def thumbnails(folder: Path | None) -> tuple[Path, ...]:
    """Return a few photographs of the chosen folder, to show them."""
    return _look(sample_photographs, folder) or ()


def forget() -> None:
    """Look at all folders again when they are asked for next."""
    _known.clear()


def _look(function: Callable[[Path], Any], folder: Path | None) -> Any:
    if folder is None:
        return None
    now = time.monotonic()
    looked, result = _known.get((function, folder), (-CHECK_SECONDS, None))
    if now - looked >= CHECK_SECONDS:
        result = function(folder)
        _known[function, folder] = (now, result)
    return result
