# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults and hostile input: killed jobs, full disks, little memory, broken files and long queues, as a table, JSON and a page.

    .venv/bin/python scripts/faults.py --quick            # cases of seconds, which are tests too
    .venv/bin/python scripts/faults.py -o faults          # all cases: hours on one core, one for 100,000 broken files of each kind

Exit status: 0 every case holds, 1 one does not, 2 bad usage.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from faulting.cases import CASES
from stresses.runner import examine

GROUPS = ("kill", "disk", "memory", "long_queue", "places", "fuzz")
MODULES = (*GROUPS, "kill_capture")  # of the group "kill", too


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the chosen cases, report, and return the exit status."""
    for name in MODULES:
        importlib.import_module(f"faulting.{name}")
    return examine(CASES, "faults", "Faults and hostile input", arguments)


if __name__ == "__main__":
    sys.exit(main())
