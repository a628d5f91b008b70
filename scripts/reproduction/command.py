# SPDX-License-Identifier: GPL-3.0-or-later
"""Command line of a script that does long work: progress on the terminal, and one line for an error."""

from __future__ import annotations

import sys
from collections.abc import Callable

from irgspp.core.errors import IrgsppError
from irgspp.core.progress.terminal import Terminal


def run_command(name: str, work: Callable[[Terminal], int]) -> int:
    """Do the work of a script and return its exit status; an IrgsppError is printed as one line.

    Args:
        name: of the script.
        work: returns the exit status; it gets the terminal, which Ctrl-C cancels.
    """
    try:
        with Terminal().signals() as terminal:
            return work(terminal)
    except IrgsppError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return error.exit_status
