# SPDX-License-Identifier: GPL-3.0-or-later
"""A guard: a value that is NaN or infinite ends a stage with one line that names it."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from ...errors import IrgsppError

LOOK_EVERY = 50  # steps between looks at what a device computes, as the host has to wait for it


def due(value: torch.Tensor, done: int) -> bool:
    """Whether a value of step `done`, from 1 on, is to be looked at: each on the CPU, now and then on a device; NaN does not go away."""
    return value.device.type == "cpu" or done % LOOK_EVERY == 1


def require_finite(values: Mapping[str, torch.Tensor], when: str) -> None:
    """Raise IrgsppError for the first of the named tensors that holds something not finite; `when` says where in the work that is."""
    for name, value in values.items():
        bad = int((~value.isfinite()).sum())
        if bad:
            raise IrgsppError(f"{name} is not finite {when} ({bad} of {value.numel()} values)")
