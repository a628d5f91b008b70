# SPDX-License-Identifier: GPL-3.0-or-later
"""Inputs of a finished or stopped capture, with which it is changed in place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..datasets.formats.captured import FILE, load_capture
from ..errors import InputError
from ..settings.overrides import from_dict
from ..settings.schema import CaptureSettings


def captured_inputs(folder: Path) -> tuple[Path, CaptureSettings, int] | None:
    """Return photographs, settings and seed of the capture in a folder; None where it holds none.

    Args:
        folder: what the user named as photographs.

    Raises:
        InputError: if its capture.json is damaged, or the photographs are gone.
    """
    file = folder / FILE
    if not file.is_file():
        return None
    state = load_capture(file)
    settings = captured_settings(state, file)
    try:
        source, seed = Path(state["inputs"]["source"]), int(state["inputs"]["seed"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(file, f"is broken ({error!r})", "run irgspp capture again on the photographs") from error
    if not source.exists():
        raise InputError(file, f"names photographs that are gone, {source}", "run irgspp capture PHOTOS -o DATASET where they are now")
    return source, settings, seed


def captured_settings(state: dict[str, Any], where: object) -> CaptureSettings:
    """Return the settings of a capture from the content of its capture.json; missing ones have their defaults.

    Args:
        state: content of the file.
        where: the file, for errors.

    Raises:
        InputError: if they are damaged or of another version.
    """
    settings = state.get("inputs", {}).get("settings", {})
    if not isinstance(settings, dict):
        raise InputError(where, "has no settings", "capture the photographs again")
    return from_dict({"capture": settings}, where).capture
