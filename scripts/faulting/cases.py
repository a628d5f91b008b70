# SPDX-License-Identifier: GPL-3.0-or-later
"""The cases of faults and hostile input, apart from those of the numerical stress test."""

from __future__ import annotations

from collections.abc import Callable

from stresses.case import Case, Measured, group

CASES: list[Case] = []

Register = Callable[[Callable[[Measured], None]], Callable[[Measured], None]]


def case_of(name: str) -> Callable[..., Register]:
    """A decorator (name, holds, quick) that registers cases of this group."""
    return group(name, CASES)
