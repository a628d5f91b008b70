# SPDX-License-Identifier: GPL-3.0-or-later
"""Event log of a job: events.jsonl and log.txt in a folder, read by other processes while the job runs."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any


class EventLog:
    """Folder with the events and the log of a job."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def event(self, **values: Any) -> None:
        """Append one JSON object to events.jsonl; values that are not finite become null, since JSON can't express them."""
        finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()}
        with (self.path / "events.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"time": round(time.time(), 3), **finite}) + "\n")

    def rule(self, name: str, on: bool, evidence: str) -> None:
        """Log the decision on a rule such as a skip rule.

        Args:
            name: of the setting, without its group.
            on: True where the rule is in force.
            evidence: reason, in one line.
        """
        self.log(f"{name} {'on' if on else 'off'}: {evidence}")

    def log(self, text: str) -> None:
        """Append a line to log.txt, after the time of day."""
        with (self.path / "log.txt").open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
