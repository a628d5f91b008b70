# SPDX-License-Identifier: GPL-3.0-or-later
"""How a run folder stands, looked up at most twice a second however often a panel draws."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

LOOK_EVERY = 0.5  # seconds

_known: dict[Path, tuple[float, RunState]] = {}


@dataclass(frozen=True)
class RunState:
    """What run.json says."""

    status: str = ""  # "running", "done", "failed", "cancelled"; "broken": it can't be read; "": there is none
    training: dict[str, Any] = field(default_factory=dict)  # figures of the training
    skipped: tuple[str, ...] = ()  # what is not there, and why


def run_state(path: Path | None) -> RunState:
    """The state of a run folder, at most half a second old."""
    if path is None:
        return RunState()
    now = time.monotonic()
    looked, state = _known.get(path, (-LOOK_EVERY, RunState()))
    if now - looked >= LOOK_EVERY:
        state = _read(path / "run.json")
        _known[path] = (now, state)
    return state


@lru_cache(maxsize=256)
def resolved(path: Path | None) -> Path | None:
    """A path as datablocks name their folder; kept, since panels ask often and it is looked up link by link."""
    return path.resolve() if path is not None else None


def _read(path: Path) -> RunState:
    try:
        run = json.loads(path.read_text("utf-8"))
        skipped = tuple(f"{part['what']}: {part['why']}" for part in run["skipped"])
        return RunState(str(run["status"]), dict(run["training"]), skipped)
    except FileNotFoundError:
        return RunState()
    except (OSError, ValueError, KeyError, TypeError):  # shown as such: another program's file, or a disk that does not answer
        return RunState("broken")
