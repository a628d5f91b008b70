# SPDX-License-Identifier: GPL-3.0-or-later
"""Reader of the folders that `irgspp capture` writes: a COLMAP model in the world's frame, exposure gains, and the object's bound."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...scene.dataset import Bound
from ...scene.surroundings import load_surroundings
from ...settings.schema import DataSettings
from ..parsed_dataset import Frame, ParsedDataset
from .colmap import read_frames

FILE, EXPOSURES, SURROUNDINGS = "capture.json", "exposures.json", "surroundings.npz"
MASK_ERROR = 0.003  # distance by which masks that were found may be wrong, in longest sides of an image; measured on captures with truth
FORMAT = "irgspp-capture"  # value of "format" in the file


def find_capture(folder: Path) -> Path | None:
    """Return the capture.json of a folder, or None."""
    file = folder / FILE
    return file if file.is_file() else None


def read_captured(folder: Path, settings: DataSettings) -> ParsedDataset:
    """Read a captured dataset; its frame is the world.

    Args:
        folder: folder with capture.json and exposures.json.
        settings: settings of the dataset.

    Raises:
        InputError: if the capture was not finished, or a file is missing or damaged.
    """
    file = folder / FILE
    state = load_capture(file)
    if state.get("status") != "done":
        raise InputError(file, "the capture was not finished", "run irgspp capture again with the same folder; it goes on where it stopped")
    frames, points, _, warnings = read_frames(folder / "sparse" / "0", settings.resolution)
    bound = state.get("bound")
    try:
        sphere = None if bound is None else _bound(bound)
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise InputError(file, f"is broken ({error!r})", "run irgspp capture again") from error
    frames = _with_gains(frames, folder / EXPOSURES)
    around = load_surroundings(folder / SURROUNDINGS) if (folder / SURROUNDINGS).is_file() else None
    about = {"surroundings": around, "mask_error": MASK_ERROR, "warnings": warnings}
    return ParsedDataset(file, folder, "capture", frames, None, np.eye(4), points, sphere, **about)


def load_capture(file: Path) -> dict[str, Any]:
    """Return the content of a capture.json.

    Raises:
        InputError: if the file is damaged or of another program.
    """
    state = _load_json(file)
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        raise InputError(file, f"is not a file of irgspp capture (no format {FORMAT!r})")
    return state


def _load_json(file: Path) -> Any:
    try:
        return json.loads(file.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(file, f"can't be read ({error})", "run irgspp capture again") from error


def _with_gains(frames: list[Frame], file: Path) -> list[Frame]:
    """Return the frames with their linear exposure gains, (3,) each, from exposures.json."""
    gains = _load_json(file)
    try:
        return [replace(frame, gain=_gain(gains[Path(frame.listed).stem], frame.listed)) for frame in frames]
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(file, f"is broken ({error!r})", "run irgspp capture again") from error


def _gain(value: object, name: str) -> np.ndarray:
    gain = np.array(value, np.float64)
    if gain.shape != (3,) or not np.isfinite(gain).all() or gain.min() <= 0:
        raise ValueError(f"gain of {name}")
    return gain


def _bound(value: dict[str, Any]) -> Bound:
    x, y, z = (float(v) for v in value["centre"])
    radius = float(value["radius"])
    if not np.isfinite((x, y, z, radius)).all() or radius <= 0:
        raise ValueError("bound")
    return Bound((x, y, z), radius)
