# SPDX-License-Identifier: GPL-3.0-or-later
"""Registry of the cases of faults and hostile input, separate from those of the numerical stress test."""

from __future__ import annotations

from collections.abc import Callable

from stresses.case import Case, Measured, group

CASES: list[Case] = []

Register = Callable[[Callable[[Measured], None]], Callable[[Measured], None]]


def case_of(name: str) -> Callable[..., Register]:
    """Return a decorator (name, holds, quick) that registers cases of a group."""
    return group(name, CASES)
