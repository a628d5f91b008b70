# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of a first stage's checkpoint: kernels and the optimiser trust its shapes and ranges."""

from __future__ import annotations

from typing import Any

import torch

from ...errors import InputError
from ..common.optimizer import GaussianOptimizer


def invalid_checkpoint() -> InputError:
    """Return the error about a checkpoint file that can be read, but holds no state of this job's first stage."""
    return InputError("checkpoint/first_stage.pt", "holds no state of this job's first stage", "delete it, or start again with --overwrite")


def state_fits(state: dict[str, Any], view_count: int, optimizer: GaussianOptimizer) -> bool:
    """Return True where a state is one of a first stage with this optimiser; may raise on values of a wrong type.

    Args:
        state: as `Trainer.state` returns it, or anything else.
        view_count: number of training views.
        optimizer: optimiser of the trainer that is to continue.
    """
    torch.Generator().set_state(state["generator"])
    order, gradient, seen = state["order"], state["gradient"], state["seen"]
    views = order.dtype == torch.long and order.ndim == 1 and bool(((order >= 0) & (order < view_count)).all())
    statistics = gradient.dtype == seen.dtype == torch.float32 and gradient.shape == seen.shape == (len(seen),)
    counts = all(type(state[name]) is int for name in ("done", "iterations", "pictures"))
    edges = type(state["open_edges"]) is float and 0 <= state["open_edges"] <= 1
    schedule = counts and edges and 0 <= state["done"] <= state["iterations"] and state["iterations"] > 0 and state["pictures"] >= 0
    return views and statistics and schedule and optimizer.fits(state["optimizer"])
