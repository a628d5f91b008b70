# SPDX-License-Identifier: GPL-3.0-or-later
"""capture.json of a captured dataset: what `irgspp capture` found in photographs, and what it left out."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FILE = "capture.json"
FORMAT = "irgspp-capture"  # value of "format" in the file
CERTAIN = ("none", "given", "found")  # kinds of masks that need no look; any other text says why a mask is doubtful


@dataclass(frozen=True)
class CaptureSummary:
    """Part of capture.json that operators and panels show.

    Attributes:
        status: "running" (also where it was stopped), "done", or "broken" for a file that can't be read.
        source: folder of photographs, or video.
        used: number of photographs with cameras.
        left_out: names and reasons of the others.
        masked: number of photographs with a mask.
        doubtful: names of photographs with an uncertain mask.
        true_size: True where a unit is a metre.
        bound: centre and radius, (4,), of the object's sphere; None where nothing was cut out.
    """

    status: str
    source: str = ""
    used: int = 0
    left_out: tuple[tuple[str, str], ...] = ()
    masked: int = 0
    doubtful: tuple[str, ...] = ()
    true_size: bool = False
    bound: tuple[float, ...] | None = None


def read_capture(folder: Path) -> CaptureSummary | None:
    """Return the summary of a captured dataset; None if the folder holds none."""
    try:
        state = json.loads((folder / FILE).read_text("utf-8"))
        return _summary(state) if state["format"] == FORMAT else CaptureSummary("broken")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):  # damaged, or another program's file of that name
        return CaptureSummary("broken")


def _summary(state: dict[str, Any]) -> CaptureSummary:
    source = str(state["inputs"]["source"])
    if state["status"] != "done":
        return CaptureSummary("running", source)
    masks = {str(one["name"]): str(one["mask"]) for one in state["photographs"]}
    return CaptureSummary(
        "done",
        source,
        len(masks),
        tuple((str(one["name"]), str(one["reason"])) for one in state["left_out"]),
        sum(kind != "none" for kind in masks.values()),
        tuple(name for name, kind in masks.items() if kind not in CERTAIN),
        state["metres_per_unit"] is not None,
        None if state["bound"] is None else (*map(float, state["bound"]["centre"]), float(state["bound"]["radius"])),
    )
