# SPDX-License-Identifier: GPL-3.0-or-later
"""What long work tells and asks: an interface, so that stages know neither terminals nor run folders."""

from __future__ import annotations

from typing import Any, Protocol


class Progress(Protocol):
    """Receives the progress of a job.

    `phase` opens a phase of a known number of steps; `step` reports the number of steps done, with figures such as `loss` and
    `psnr`; `message` is one line for a person. `cancelled` turns True when the user wants the work to stop: the worker
    saves what it has and raises `errors.Cancelled`.
    """

    cancelled: bool

    def phase(self, name: str, steps: int) -> None: ...

    def step(self, done: int, **figures: float) -> None: ...

    def message(self, text: str) -> None: ...


class Silent:
    """Progress that nobody watches."""

    cancelled = False

    def phase(self, name: str, steps: int) -> None:
        """Ignored."""

    def step(self, done: int, **figures: float) -> None:
        """Ignored."""

    def message(self, text: str) -> None:
        """Ignored."""


class Checkpoint(Protocol):
    """Where a stage keeps enough to go on: a dict of tensors, arrays, numbers and strings (nested dicts allowed) under a name."""

    def save(self, name: str, state: dict[str, Any]) -> None: ...

    def load(self, name: str) -> dict[str, Any] | None: ...
