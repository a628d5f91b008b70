# SPDX-License-Identifier: GPL-3.0-or-later
"""State of a run folder, read at most twice a second however often panels are drawn."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

CHECK_SECONDS = 0.5  # between two reads

_known: dict[Path, tuple[float, RunState]] = {}


@dataclass(frozen=True)
class RunState:
    """Part of run.json that panels show."""

    status: str = ""  # "running", "done", "failed", "cancelled"; "broken": unreadable; "": no run
    training: dict[str, Any] = field(default_factory=dict)  # metrics of the training
    skipped: tuple[str, ...] = ()  # skipped parts, with the reason
    textures: dict[str, Any] = field(default_factory=dict)  # size and baked in texels along a side; empty in runs of earlier versions


def run_state(path: Path | None) -> RunState:
    """Return the state of a run folder, at most half a second old."""
    if path is None:
        return RunState()
    now = time.monotonic()
    looked, state = _known.get(path, (-CHECK_SECONDS, RunState()))
    if now - looked >= CHECK_SECONDS:
        state = _read(path / "run.json")
        _known[path] = (now, state)
    return state


@lru_cache(maxsize=256)
def resolved(path: Path | None) -> Path | None:
    """Return a path without links, as datablocks name their run folder; cached, since resolving is slow and panels are drawn often."""
    return path.resolve() if path is not None else None


def _read(path: Path) -> RunState:
    try:
        run = json.loads(path.read_text("utf-8"))
        skipped = tuple(f"{part['what']}: {part['why']}" for part in run["skipped"])
        return RunState(str(run["status"]), dict(run["training"]), skipped, dict(run.get("textures", {})))
    except FileNotFoundError:
        return RunState()
    except (OSError, ValueError, KeyError, TypeError):  # another program's file, or a disk that does not respond
        return RunState("broken")
