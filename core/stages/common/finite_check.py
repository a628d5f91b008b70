# SPDX-License-Identifier: GPL-3.0-or-later
"""Check for NaN and infinity: a stage ends with one line that names the value."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from ...errors import IrgsppError

CHECK_EVERY = 50  # steps between checks on a GPU, as each makes the host wait for the device


def check_due(value: torch.Tensor, step: int) -> bool:
    """Return True where a value of this step is to be checked: each on the CPU, every CHECK_EVERY-th on a GPU (NaN persists).

    Args:
        value: tensor (...,) of any shape; only its device matters.
        step: number of the step, from 1 on.
    """
    return value.device.type == "cpu" or step % CHECK_EVERY == 1


def require_finite(values: Mapping[str, torch.Tensor], when: str) -> None:
    """Check that named tensors are finite.

    Args:
        values: tensors (...,) of any shape by their names in the message.
        when: point of the computation, for the message: "at iteration 3".

    Raises:
        IrgsppError: a tensor holds NaN or infinity; the first one is named.
    """
    for name, value in values.items():
        bad = int((~value.isfinite()).sum())
        if bad:
            raise IrgsppError(f"{name} is not finite {when} ({bad} of {value.numel()} values)")
