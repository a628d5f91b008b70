# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam: torch's, without torch's compiler, and for float32 with a step that is one pass over all tensors."""

from __future__ import annotations

import inspect

import torch

from ...kernels.adam import adam_step
from ...kernels.adam_tensor import AdamTensor


class Adam(torch.optim.Adam):
    """torch's Adam (Kingma and Ba 2015), the same up to rounding, and with the same state, but that "step" is a number of the host.

    `torch.optim` wraps its methods for torch's compiler and imports that on the first call. The import takes seconds, and nothing here is
    compiled by it: the methods are called without their wrappers.

    A group may have an entry "rows": only so many leading rows of its tensors are stepped on. The others must never have had a gradient,
    so that a step would not change them.
    """

    add_param_group = inspect.unwrap(torch.optim.Optimizer.add_param_group)
    zero_grad = inspect.unwrap(torch.optim.Optimizer.zero_grad)

    @torch.no_grad()
    def step(self) -> bool:
        """Do one step with the gradients of all parameters.

        Returns:
            True where all new values are known to be finite; never on a GPU, where the answer would have to be waited for.
        """
        tensors = [(group, p) for group in self.param_groups for p in group["params"] if p.grad is not None]
        if not all(p.dtype == torch.float32 and p.is_contiguous() for _, p in tensors):
            inspect.unwrap(torch.optim.Adam.step)(self)
            return False
        return adam_step([self._prepared(group, p) for group, p in tensors], self.defaults["betas"], self.defaults["eps"])

    def _prepared(self, group: dict, p: torch.Tensor) -> AdamTensor:
        """Count the step of a parameter, which gets moments at its first; return what the kernel needs."""
        assert p.grad is not None
        state = self.state[p]
        if not state:
            state |= {"step": 0, "exp_avg": torch.zeros_like(p), "exp_avg_sq": torch.zeros_like(p)}
        state["step"] += 1
        count = group["rows"] * p[0].numel() if "rows" in group else p.numel()
        moments = state["exp_avg"], state["exp_avg_sq"]
        return AdamTensor(p, p.grad.contiguous(), *moments, state["step"], group["lr"], count)
