# SPDX-License-Identifier: GPL-3.0-or-later
"""What a case of the stress test is: a statement of what must hold, a function that measures it, and the verdict."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import torch


@dataclass
class Measured:
    """What a case finds. Each figure is compared with its limit at once; those beyond it are remembered and fail the case."""

    figures: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def at_most(self, what: str, value: float, limit: float) -> None:
        """`value` must not exceed `limit`; NaN does."""
        self._say(f"{what} {value:.2g} (at most {limit:.2g})", float(value) <= limit)

    def at_least(self, what: str, value: float, limit: float) -> None:
        """`value` must not fall short of `limit`; NaN does."""
        self._say(f"{what} {value:.3g} (at least {limit:.3g})", float(value) >= limit)

    def holds(self, what: str, true: bool) -> None:
        """A fact that has no figure; said in the table where it is not one."""
        if not true:
            self._say(f"NOT: {what}", False)

    def finite(self, what: str, values: torch.Tensor | Iterable[torch.Tensor | None]) -> None:
        """All of it is finite. None, a gradient that was never made, counts as a fault."""
        tensors = [values] if isinstance(values, torch.Tensor) else list(values)
        bad = sum(1 if t is None else int((~t.detach().isfinite()).sum()) for t in tensors)
        self.holds(f"{what} finite ({bad} values are not)", bad == 0)

    def note(self, text: str) -> None:
        """A figure that limits nothing."""
        self.figures.append(text)

    def _say(self, text: str, true: bool) -> None:
        self.figures.append(text)
        if not true:
            self.faults.append(text)


@dataclass(frozen=True)
class Case:
    """One case: `name` says what is done, `holds` what must hold in one line; `quick` ones are part of the test suite."""

    group: str
    name: str
    holds: str
    run: Callable[[Measured], None]
    quick: bool = True


@dataclass(frozen=True)
class Outcome:
    """What came of a case: its figures, faults (none where it holds), and the seconds it took."""

    case: Case
    figures: list[str]
    faults: list[str]
    seconds: float

    @property
    def passed(self) -> bool:
        """True where everything that must hold does."""
        return not self.faults


CASES: list[Case] = []


def group(name: str, cases: list[Case] = CASES) -> Callable[..., Callable[[Callable[[Measured], None]], Callable[[Measured], None]]]:
    """A decorator (name, holds, quick) that registers cases of this group, among those of the numerical stress test by default."""

    def case(title: str, holds: str, quick: bool = True) -> Callable[[Callable[[Measured], None]], Callable[[Measured], None]]:
        def register(function: Callable[[Measured], None]) -> Callable[[Measured], None]:
            cases.append(Case(name, title, " ".join(holds.split()), function, quick))
            return function

        return register

    return case


def attempt(case: Case) -> Outcome:
    """Run a case. An exception is a fault like any other: one case must not hide the rest."""
    measured, began = Measured(), time.perf_counter()
    try:
        case.run(measured)
    except Exception as error:  # whatever it is, it is what the case found
        measured.faults.append(f"{type(error).__name__}: {error}")
        measured.figures.append(measured.faults[-1])
    if not measured.figures:
        measured.note("as stated")
    return Outcome(case, measured.figures, measured.faults, time.perf_counter() - began)


def relative(got: torch.Tensor, wanted: torch.Tensor) -> float:
    """|got - wanted| / |wanted|, L2 over all values; infinite where one of them is not finite, 0 where both are zero."""
    difference, size = float((got.double() - wanted.double()).norm()), float(wanted.double().norm())
    if not math.isfinite(difference + size):
        return math.inf
    return difference / size if size > 0 else difference
