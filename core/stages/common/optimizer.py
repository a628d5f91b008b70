# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam optimiser over Gaussians whose number changes."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ...errors import IrgsppError
from ...scene.gaussians import Gaussians
from .adam import Adam
from .finite_check import check_due

ROWS = {"sh_dc": ("sh", slice(0, 1)), "sh_rest": ("sh", slice(1, None)), "albedo": ("material", slice(0, 3))}
ROWS |= {"roughness": ("material", slice(3, 4)), "metallic": ("material", slice(4, 5))}


@dataclass(frozen=True)
class Rate:
    """Learning rate that decays exponentially over the schedule.

    Attributes:
        start: rate at the start.
        final: factor of it at the end.
    """

    start: float
    final: float = 1.0

    def at(self, progress: float) -> float:
        """Return the rate at a progress of 0..1 through the schedule."""
        return self.start * self.final**progress

    def times(self, factor: float) -> Rate:
        """Return the rate multiplied by a factor over the whole schedule."""
        return Rate(factor * self.start, self.final)


class GaussianOptimizer:
    """Adam (eps 1e-15, as in 3DGS) with a learning rate per group; groups that share a tensor (SH dc and rest) step on views of it.

    A NaN or infinite value, given or computed by a step, raises IrgsppError that names the parameter and the iteration.

    Attributes:
        leaves: parameters of the Gaussians by name, shapes as in `Gaussians`; gradients flow to them.
        others: further optimised tensors by name, not per Gaussian.
        rates: learning rate of each group by name.
        adam: the optimiser of the groups.
        coefficients: leading SH coefficients of which any has had a gradient; a step changes no others.
    """

    def __init__(self, gaussians: Gaussians, rates: dict[str, Rate], others: dict[str, torch.Tensor] | None = None) -> None:
        """Start with fresh moments.

        Args:
            gaussians: initial values, which are copied.
            rates: learning rates by parameter or ROWS name; parameters without a rate are not optimised.
            others: further tensors by name, not per Gaussian; they are updated in place.

        Raises:
            IrgsppError: a value is not finite.
        """
        self.rates, self.others, self._steps, self.coefficients = rates, others or {}, 0, 0
        self.adopt(gaussians)
        self.check_finite()

    def adopt(self, gaussians: Gaussians) -> None:
        """Replace the parameters by a copy of these Gaussians, with fresh moments."""
        self.leaves = {k: v.detach().clone(memory_format=torch.contiguous_format).requires_grad_() for k, v in gaussians.tensors().items()}
        groups = [{"params": [self._view(name)], "name": name, "lr": rate.start} for name, rate in self.rates.items()]
        self.adam = Adam(groups, eps=1e-15, fused=True)

    def _view(self, name: str) -> torch.Tensor:
        """Return the tensor of a group, or the rows of a leaf that belong to it."""
        if name in self.others:
            return self.others[name]
        leaf, rows = ROWS.get(name, (name, slice(None)))
        return self.leaves[leaf].detach()[rows]

    @property
    def gaussians(self) -> Gaussians:
        """The current parameters; gradients flow to them."""
        return Gaussians(**self.leaves)

    def step(self, progress: float, coefficients: int = 16) -> None:
        """Do one step, then discard the gradients.

        Args:
            progress: 0..1 through the schedule, which the rates depend on.
            coefficients: leading SH coefficients that have a gradient.
        """
        self.coefficients = max(self.coefficients, coefficients)
        for group in self.adam.param_groups:
            group["lr"] = self.rates[group["name"]].at(progress)
            if group["name"] == "sh_rest":
                group["rows"] = min(self.coefficients - 1, len(group["params"][0]))
            if group["name"] not in self.others:
                leaf, rows = ROWS.get(group["name"], (group["name"], slice(None)))
                gradient = self.leaves[leaf].grad
                group["params"][0].grad = None if gradient is None else gradient[rows]
        known = self.adam.step()
        self._steps += 1
        if check_due(self.leaves["position"], self._steps) and not (known and _sums_finite(self._not_stepped_on())):
            self.check_finite()
        for tensor in (*self.leaves.values(), *self.others.values()):
            tensor.grad = None

    def _not_stepped_on(self) -> list[torch.Tensor]:
        """Return the tensors of which not all values have a learning rate and a gradient."""
        parts = {name: [part for part, (leaf, _) in ROWS.items() if leaf == name] or [name] for name in self.leaves}
        leaves = [leaf for name, leaf in self.leaves.items() if leaf.grad is None or not all(part in self.rates for part in parts[name])]
        return leaves + [other for other in self.others.values() if other.grad is None]

    @property
    def iteration(self) -> int:
        """Number of steps done so far, those before a checkpoint included."""
        return max((int(state["step"]) for state in self.adam.state.values()), default=0)

    def check_finite(self) -> None:
        """Check all parameters; raise IrgsppError where a value is NaN or infinite."""
        named = self.leaves | self.others
        with torch.no_grad():
            if _sums_finite(list(named.values())):
                return
            for name, tensor in named.items():
                parts = {k: rows for k, (leaf, rows) in ROWS.items() if leaf == name} or {name: slice(None)}
                for part, rows in parts.items():
                    if not tensor[rows].isfinite().all():
                        raise IrgsppError(self._describe(part, tensor, rows))

    def _describe(self, part: str, tensor: torch.Tensor, rows: slice) -> str:
        """Describe in one line the values in `rows` of `tensor` that are not finite, and their cause."""
        bad = int((~tensor[rows].isfinite()).sum())
        gradient = "" if tensor.grad is None or tensor.grad[rows].isfinite().all() else ", made by a gradient that is not finite"
        return f"{part} is not finite after iteration {self.iteration} ({bad} of {tensor[rows].numel()} values{gradient})"

    def rebuild(self, gaussians: Gaussians, origin: torch.Tensor) -> None:
        """Continue with another set of Gaussians.

        Args:
            gaussians: the new set of N Gaussians.
            origin: (N,) index in the old set whose moments each new Gaussian takes over; -1 for zero moments.

        Raises:
            IrgsppError: a value is not finite.
        """
        origin = origin.to(self.leaves["position"].device)
        old = {g["name"]: self.adam.state.get(g["params"][0], {}) for g in self.adam.param_groups}
        self.adopt(gaussians)
        for group in self.adam.param_groups:
            state = old[group["name"]]
            if not state:
                continue
            if group["name"] in self.others:
                self.adam.state[group["params"][0]] = state
                continue
            moved = {k: torch.where(origin >= 0, state[k][..., origin.clamp_min(0)], 0.0) for k in ("exp_avg", "exp_avg_sq")}
            self.adam.state[group["params"][0]] = {"step": state["step"], **moved}
        self.check_finite()

    def reset_moments(self, name: str) -> None:
        """Set the moments of one group to zero, because its values were overwritten."""
        for group in self.adam.param_groups:
            if group["name"] == name:
                for key in ("exp_avg", "exp_avg_sq"):
                    self.adam.state[group["params"][0]][key].zero_()

    def state(self) -> dict[str, dict[str, torch.Tensor]]:
        """Return values and moments for a checkpoint."""
        moments = {g["name"]: dict(self.adam.state[g["params"][0]]) for g in self.adam.param_groups if g["params"][0] in self.adam.state}
        flat = {f"{name}.{key}": torch.as_tensor(value, dtype=torch.float32) for name, s in moments.items() for key, value in s.items()}
        values = {k: v.detach() for k, v in self.leaves.items()}
        return {"values": values, "others": {k: v.detach() for k, v in self.others.items()}, "moments": flat}

    def fits(self, state: dict[str, dict[str, torch.Tensor]]) -> bool:
        """Return True where a `state` fits this optimiser: kernels and the fused Adam trust shapes.

        Args:
            state: values (..., N) of any number N of Gaussians, other tensors and moments, as `state` returns them.
        """
        count = state["values"]["position"].shape[1]
        values = {name: (*leaf.shape[:-1], count) for name, leaf in self.leaves.items()}
        others, moments = _shapes(self.others), {}
        for name in (name for name in self.rates if f"{name}.step" in state["moments"]):
            leaf, rows = ROWS.get(name, (name, slice(None)))
            shape = others[name] if name in others else (len(range(*rows.indices(values[leaf][0]))), *values[leaf][1:])
            moments |= {f"{name}.step": (), f"{name}.exp_avg": shape, f"{name}.exp_avg_sq": shape}
        expected = {"values": values, "others": others, "moments": moments}
        return count > 0 and all(_shapes(state[part]) == shapes for part, shapes in expected.items())

    def restore(self, state: dict[str, dict[str, torch.Tensor]]) -> None:
        """Continue from a state.

        Args:
            state: values (..., N), other tensors and moments, as `state` returns them.

        Raises:
            IrgsppError: a value is not finite.
        """
        for name, value in state["others"].items():
            self.others[name].data.copy_(value)
        device = self.leaves["position"].device
        self.adopt(Gaussians(**state["values"]).to(device))
        for group in self.adam.param_groups:
            prefix = group["name"] + "."
            moments = {k.removeprefix(prefix): v.to(device) for k, v in state["moments"].items() if k.startswith(prefix)}
            if moments:
                self.adam.state[group["params"][0]] = moments | {"step": int(moments["step"])}
        self.coefficients = 16  # of the moments in a checkpoint, any may have been used
        self.check_finite()


def _sums_finite(tensors: list[torch.Tensor]) -> bool:
    """Return True where the sums of all tensors are finite: a fifth of the time of testing each value; False also where one overflows."""
    with torch.no_grad():
        return not tensors or bool(torch.stack([tensor.sum() for tensor in tensors]).isfinite().all())


def _shapes(tensors: dict[str, torch.Tensor]) -> dict[str, tuple[int, ...] | None]:
    """Return the shape of each tensor that is dense, float32 and finite; None for others."""

    def usable(tensor: torch.Tensor) -> bool:
        dense = tensor.dtype == torch.float32 and tensor.layout == torch.strided and tensor.is_contiguous()
        return dense and bool(tensor.isfinite().all())

    return {name: tuple(tensor.shape) if usable(tensor) else None for name, tensor in tensors.items()}
