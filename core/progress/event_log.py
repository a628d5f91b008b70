# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job notes down while it works, for whoever watches: events.jsonl and log.txt in a folder."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any


class EventLog:
    """A folder with a job's events and log."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def event(self, **values: Any) -> None:
        """Append one JSON object to events.jsonl; values that are not finite become null, as JSON has no word for them."""
        finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
        with (self.path / "events.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"time": round(time.time(), 3), **finite}) + "\n")

    def rule(self, name: str, on: bool, evidence: str) -> None:
        """Note whether a rule that leaves work out is in force."""
        self.log(f"skip.{name} {'on' if on else 'off'}: {evidence}")

    def log(self, text: str) -> None:
        """Append to log.txt, with the time."""
        with (self.path / "log.txt").open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
