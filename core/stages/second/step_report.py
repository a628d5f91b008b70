# SPDX-License-Identifier: GPL-3.0-or-later
"""Report of the second stage's steps."""

from __future__ import annotations

from ...errors import Cancelled
from ...progress.protocol import Progress


def report_step(progress: Progress, done: int) -> bool:
    """Report the number of steps done in the second stage; return True where the user asks to finish early.

    Args:
        progress: receives the number.
        done: steps.

    Raises:
        Cancelled: the user stopped the work.
    """
    progress.step(done)
    if progress.cancelled:
        raise Cancelled("stopped in the second stage")
    return progress.finish_early
