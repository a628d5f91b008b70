# SPDX-License-Identifier: GPL-3.0-or-later
"""torch's Adam without torch's compiler."""

from __future__ import annotations

import inspect

import torch


class Adam(torch.optim.Adam):
    """torch's Adam (Kingma and Ba 2015), the same to the bit.

    `torch.optim` wraps its methods for torch's compiler and imports that on the first call. The import takes seconds, and nothing here is
    compiled by it: the methods are called without their wrappers.
    """

    add_param_group = inspect.unwrap(torch.optim.Optimizer.add_param_group)
    zero_grad = inspect.unwrap(torch.optim.Optimizer.zero_grad)

    @torch.no_grad()
    def step(self) -> None:
        """Do one step with the gradients of all parameters."""
        inspect.unwrap(torch.optim.Adam.step)(self)
