# SPDX-License-Identifier: GPL-3.0-or-later
"""Exit status of modules that run in a Blender process of their own."""

from __future__ import annotations

import sys
from collections.abc import Callable

from ..core.errors import IrgsppError


def exit_status(work: Callable[[], object]) -> int:
    """Do the work of a command line and return its exit status; an IrgsppError is printed as one line."""
    try:
        work()
    except IrgsppError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    return 0
