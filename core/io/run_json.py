# SPDX-License-Identifier: GPL-3.0-or-later
"""run.json of a run folder, with today's names of phases in place of those of earlier versions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ..errors import InputError

OLD_PHASES = {"reflective": "first stage", "transport": "second stage"}  # names of phases in version 0.1 -> now


def read_run(path: Path) -> dict[str, Any]:
    """Return run.json of the run folder `path`, with today's names of phases.

    Raises:
        InputError: there is no run.json, or it is broken.
    """
    file = path / "run.json"
    if not file.is_file():
        raise InputError(path, "is not a run folder (no run.json in it)")
    try:
        state = json.loads(file.read_text("utf-8"))
        phases = {OLD_PHASES.get(name, name): _phase(phase) for name, phase in state["phases"].items()}
        state |= {"phases": phases, "settings": dict(state["settings"])}
        json.dumps(state, allow_nan=False)  # a state that can't be written again is invalid
        return state
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(file, f"is broken ({error})", "start the run again with --overwrite") from error


def udim_tiles(path: Path) -> int:
    """Return the UDIM tiles along a side of the textures of the run folder `path`; 1 where they are no tiles, or not recorded.

    Raises:
        InputError: run.json is broken.
    """
    file = path / "run.json"
    if not file.is_file():
        return 1
    try:
        tiles = (json.loads(file.read_text("utf-8")).get("textures") or {}).get("tiles", 1)
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(file, f"is broken ({error})", "start the run again with --overwrite") from error
    if type(tiles) is not int or tiles < 1:
        raise InputError(file, f"is broken (textures.tiles is {tiles!r})", "bake the run again")
    return tiles


def _phase(entry: dict[str, Any]) -> dict[str, Any]:
    return {"seconds": float(entry["seconds"]), "peak_memory": int(entry["peak_memory"]), "finished": bool(entry["finished"])}
