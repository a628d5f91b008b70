# SPDX-License-Identifier: GPL-3.0-or-later
"""Numerical stress test: statements that must hold for every input, checked case by case and reported as a table, JSON and a page.

    .venv/bin/python scripts/stress.py --quick            # the cases that are part of the test suite
    .venv/bin/python scripts/stress.py -o stress          # all of them, with 20,000 iterations and millions of triangles

Exit status: 0 every case holds, 1 one does not, 2 bad usage.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from stresses.case import CASES
from stresses.runner import examine

GROUPS = ("gaussians", "materials", "lights", "training", "endurance", "surfaces", "captures")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the chosen cases, report, and return the exit status."""
    for name in GROUPS:
        importlib.import_module(f"stresses.{name}")
    return examine(CASES, "stress", "Numerical stress test", arguments)


if __name__ == "__main__":
    sys.exit(main())
