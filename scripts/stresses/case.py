# SPDX-License-Identifier: GPL-3.0-or-later
"""Case of the stress test: a statement that must hold, a function that checks it, and its result."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import torch


@dataclass
class Measured:
    """Result of a case: each value is compared with its limit at once, and those beyond it fail the case.

    Attributes:
        figures: statements with their measured values.
        faults: statements that do not hold.
    """

    figures: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def at_most(self, what: str, value: float, limit: float) -> None:
        """Check that a value does not exceed a limit; NaN does.

        Args:
            what: name of the value.
            value: measured number.
            limit: largest number allowed.
        """
        self._add(f"{what} {value:.2g} (at most {limit:.2g})", float(value) <= limit)

    def at_least(self, what: str, value: float, limit: float) -> None:
        """Check that a value does not fall short of a limit; NaN does.

        Args:
            what: name of the value.
            value: measured number.
            limit: smallest number allowed.
        """
        self._add(f"{what} {value:.3g} (at least {limit:.3g})", float(value) >= limit)

    def holds(self, what: str, condition: bool) -> None:
        """Check a fact that has no number; it is listed where it does not hold.

        Args:
            what: statement.
            condition: True where it holds.
        """
        if not condition:
            self._add(f"NOT: {what}", False)

    def finite(self, what: str, values: torch.Tensor | Iterable[torch.Tensor | None]) -> None:
        """Check that all values are finite; None, a gradient that was never computed, is a fault.

        Args:
            what: name of the values.
            values: tensors of any shape (...,).
        """
        tensors = [values] if isinstance(values, torch.Tensor) else list(values)
        bad = sum(1 if t is None else int((~t.detach().isfinite()).sum()) for t in tensors)
        self.holds(f"{what} finite ({bad} values are not)", bad == 0)

    def note(self, text: str) -> None:
        """Add a value that has no limit."""
        self.figures.append(text)

    def _add(self, text: str, holds: bool) -> None:
        """Add a statement, and a fault where it does not hold."""
        self.figures.append(text)
        if not holds:
            self.faults.append(text)


@dataclass(frozen=True)
class Case:
    """Case of the stress test.

    Attributes:
        group: group of the case.
        name: what is done.
        holds: what must hold, in one line.
        run: function that checks it.
        quick: True for cases that are part of the test suite.
    """

    group: str
    name: str
    holds: str
    run: Callable[[Measured], None]
    quick: bool = True


@dataclass(frozen=True)
class Outcome:
    """Result of a case that has been run.

    Attributes:
        case: the case.
        figures: statements with their measured values.
        faults: statements that do not hold.
        seconds: wall clock.
    """

    case: Case
    figures: list[str]
    faults: list[str]
    seconds: float

    @property
    def passed(self) -> bool:
        """True where all statements hold."""
        return not self.faults


CASES: list[Case] = []


def group(name: str, cases: list[Case] = CASES) -> Callable[..., Callable[[Callable[[Measured], None]], Callable[[Measured], None]]]:
    """Return a decorator (name, holds, quick) that registers cases of a group.

    Args:
        name: name of the group.
        cases: list to register in; the numerical stress test's by default.
    """

    def case(title: str, holds: str, quick: bool = True) -> Callable[[Callable[[Measured], None]], Callable[[Measured], None]]:
        """Return a decorator that registers a function as a case."""

        def register(function: Callable[[Measured], None]) -> Callable[[Measured], None]:
            """Register a function."""
            cases.append(Case(name, title, " ".join(holds.split()), function, quick))
            return function

        return register

    return case


def attempt(case: Case) -> Outcome:
    """Run a case; an exception is a fault like any other, so that one case does not stop the rest."""
    measured, began = Measured(), time.perf_counter()
    try:
        case.run(measured)
    except Exception as error:  # any exception is a finding of the case
        measured.faults.append(f"{type(error).__name__}: {error}")
        measured.figures.append(measured.faults[-1])
    if not measured.figures:
        measured.note("as stated")
    return Outcome(case, measured.figures, measured.faults, time.perf_counter() - began)


def relative(got: torch.Tensor, expected: torch.Tensor) -> float:
    """Return |got - expected| / |expected|, L2 over all values.

    Args:
        got: tensor (...,).
        expected: tensor (...,) of the same shape.

    Returns:
        The ratio; infinite where a value is not finite, 0 where both are zero.
    """
    difference, size = float((got.double() - expected.double()).norm()), float(expected.double().norm())
    if not math.isfinite(difference + size):
        return math.inf
    return difference / size if size > 0 else difference
