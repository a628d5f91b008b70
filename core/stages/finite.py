# SPDX-License-Identifier: GPL-3.0-or-later
"""A guard: a value that is NaN or infinite ends a stage with one line that names it."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from ..errors import IrgsppError


def require_finite(values: Mapping[str, torch.Tensor], when: str) -> None:
    """Raise IrgsppError for the first of the named tensors that holds something not finite; `when` says where in the work that is."""
    for name, value in values.items():
        bad = int((~value.isfinite()).sum())
        if bad:
            raise IrgsppError(f"{name} is not finite {when} ({bad} of {value.numel()} values)")
