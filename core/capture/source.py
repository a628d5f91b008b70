# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths that users name as datasets: photographs without cameras, or datasets that have them."""

from __future__ import annotations

from pathlib import Path

from ..datasets.format_detection import NoDataset, parse_dataset
from ..datasets.formats.captured import FILE, load_capture
from ..errors import InputError
from ..io.run_files import CAPTURE
from ..settings.schema import DataSettings
from .photograph_files import VIDEOS, has_photographs


def needs_capture(path: Path) -> bool:
    """Return True for a video, or a folder of photographs without cameras.

    Args:
        path: what the user named as dataset.
    """
    if path.is_file():
        return path.suffix.lower() in VIDEOS
    if not path.is_dir():
        return False
    try:
        parse_dataset(path, DataSettings())
    except NoDataset:
        return has_photographs(path)
    except InputError:
        return False  # a damaged dataset, which its reader reports
    return False


def posed_dataset(path: Path, run: Path | None = None) -> Path:
    """Return the dataset with cameras that a path stands for: itself, or the capture of these photographs in a run folder.

    Args:
        path: what the user named as dataset.
        run: run folder, or None.

    Raises:
        InputError: if the photographs have no cameras, and the run has not captured them.
    """
    if not needs_capture(path):
        return path
    captured = None if run is None else run / CAPTURE
    if captured is not None and (captured / FILE).is_file():
        state = load_capture(captured / FILE)
        if state.get("status") == "done" and state.get("inputs", {}).get("source") == str(path.resolve()):
            return captured
    raise InputError(
        path, "has photographs but no cameras", "irgspp capture finds them and writes a dataset; reconstruct does so by itself"
    )
