# SPDX-License-Identifier: GPL-3.0-or-later
"""Adam over Gaussians whose number changes."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ...errors import IrgsppError
from ...scene.gaussians import Gaussians
from .finite_check import due

ROWS = {"sh_dc": ("sh", slice(0, 1)), "sh_rest": ("sh", slice(1, None)), "albedo": ("material", slice(0, 3))}
ROWS |= {"roughness": ("material", slice(3, 4)), "metallic": ("material", slice(4, 5))}


@dataclass(frozen=True)
class Rate:
    """A learning rate that falls exponentially to `final` times its start over the schedule."""

    start: float
    final: float = 1.0

    def at(self, progress: float) -> float:
        """The rate at progress 0..1."""
        return self.start * self.final**progress

    def times(self, factor: float) -> Rate:
        """The rate so many times as fast all along."""
        return Rate(factor * self.start, self.final)


class GaussianOptimizer:
    """Adam (eps 1e-15) with a rate per group; groups that share a tensor (SH dc and rest) step on views of it.

    A value that is NaN or infinite, whether it was given or made by a step, raises IrgsppError: the parameter and the iteration are named.
    """

    def __init__(self, gaussians: Gaussians, rates: dict[str, Rate], others: dict[str, torch.Tensor] | None = None) -> None:
        """`rates` by parameter or ROWS name; parameters without a rate stay as they are. `others`: further tensors, not per Gaussian."""
        self.rates, self.others, self._steps = rates, others or {}, 0
        self.adopt(gaussians)
        self.check_finite()

    def adopt(self, gaussians: Gaussians) -> None:
        """Optimise a copy of these Gaussians, with fresh moments."""
        self.leaves = {k: v.detach().clone(memory_format=torch.contiguous_format).requires_grad_() for k, v in gaussians.tensors().items()}
        groups = [{"params": [self._view(name)], "name": name, "lr": rate.start} for name, rate in self.rates.items()]
        self.adam = torch.optim.Adam(groups, eps=1e-15, fused=True)

    def _view(self, name: str) -> torch.Tensor:
        if name in self.others:
            return self.others[name]
        leaf, rows = ROWS.get(name, (name, slice(None)))
        return self.leaves[leaf].detach()[rows]

    @property
    def gaussians(self) -> Gaussians:
        """The leaves that gradients flow to."""
        return Gaussians(**self.leaves)

    def step(self, progress: float) -> None:
        """One step with the rates at `progress` 0..1, then forget the gradients."""
        for group in self.adam.param_groups:
            group["lr"] = self.rates[group["name"]].at(progress)
            if group["name"] not in self.others:
                leaf, rows = ROWS.get(group["name"], (group["name"], slice(None)))
                gradient = self.leaves[leaf].grad
                group["params"][0].grad = None if gradient is None else gradient[rows]
        self.adam.step()
        self._steps += 1
        if due(self.leaves["position"], self._steps):
            self.check_finite()
        for tensor in (*self.leaves.values(), *self.others.values()):
            tensor.grad = None

    @property
    def iteration(self) -> int:
        """Steps done so far, those before a checkpoint included."""
        return max((int(state["step"]) for state in self.adam.state.values()), default=0)

    def check_finite(self) -> None:
        """Raise IrgsppError where a value is NaN or infinite."""
        named = self.leaves | self.others
        with torch.no_grad():
            # A sum takes a fifth of the time of looking at each value; one that overflows is looked at again below.
            if torch.stack([tensor.sum() for tensor in named.values()]).isfinite().all():
                return
            for name, tensor in named.items():
                parts = {k: rows for k, (leaf, rows) in ROWS.items() if leaf == name} or {name: slice(None)}
                for part, rows in parts.items():
                    if not tensor[rows].isfinite().all():
                        raise IrgsppError(self._fault(part, tensor, rows))

    def _fault(self, part: str, tensor: torch.Tensor, rows: slice) -> str:
        """One line on values `rows` of `tensor` that are not finite, and where that comes from."""
        bad = int((~tensor[rows].isfinite()).sum())
        gradient = "" if tensor.grad is None or tensor.grad[rows].isfinite().all() else ", made by a gradient that is not"
        return f"{part} is not finite after iteration {self.iteration} ({bad} of {tensor[rows].numel()} values{gradient})"

    def rebuild(self, gaussians: Gaussians, origin: torch.Tensor) -> None:
        """Go on with other Gaussians: moments come from Gaussian origin[i] of the old set, or are zero where origin is -1."""
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
        """Forget the moments of one group (its values were overwritten)."""
        for group in self.adam.param_groups:
            if group["name"] == name:
                for key in ("exp_avg", "exp_avg_sq"):
                    self.adam.state[group["params"][0]][key].zero_()

    def state(self) -> dict[str, dict[str, torch.Tensor]]:
        """Values and moments, for a checkpoint."""
        moments = {g["name"]: dict(self.adam.state[g["params"][0]]) for g in self.adam.param_groups if g["params"][0] in self.adam.state}
        flat = {f"{name}.{key}": value for name, state in moments.items() for key, value in state.items()}
        values = {k: v.detach() for k, v in self.leaves.items()}
        return {"values": values, "others": {k: v.detach() for k, v in self.others.items()}, "moments": flat}

    def fits(self, state: dict[str, dict[str, torch.Tensor]]) -> bool:
        """Whether `state` has what this one's has, of any number of Gaussians: kernels and the fused Adam trust shapes."""
        count = state["values"]["position"].shape[1]
        values = {name: (*leaf.shape[:-1], count) for name, leaf in self.leaves.items()}
        others, moments = _shapes(self.others), {}
        for name in (name for name in self.rates if f"{name}.step" in state["moments"]):
            leaf, rows = ROWS.get(name, (name, slice(None)))
            shape = others[name] if name in others else (len(range(*rows.indices(values[leaf][0]))), *values[leaf][1:])
            moments |= {f"{name}.step": (), f"{name}.exp_avg": shape, f"{name}.exp_avg_sq": shape}
        wanted = {"values": values, "others": others, "moments": moments}
        return count > 0 and all(_shapes(state[part]) == shapes for part, shapes in wanted.items())

    def restore(self, state: dict[str, dict[str, torch.Tensor]]) -> None:
        """Go on from `state`."""
        for name, value in state["others"].items():
            self.others[name].data.copy_(value)
        device = self.leaves["position"].device
        self.adopt(Gaussians(**state["values"]).to(device))
        for group in self.adam.param_groups:
            prefix = group["name"] + "."
            moments = {k.removeprefix(prefix): v.to(device) for k, v in state["moments"].items() if k.startswith(prefix)}
            if moments:
                self.adam.state[group["params"][0]] = moments
        self.check_finite()


def _shapes(tensors: dict[str, torch.Tensor]) -> dict[str, tuple[int, ...] | None]:
    """Of tensors that are dense, of single precision and finite; None for others."""

    def plain(tensor: torch.Tensor) -> bool:
        dense = tensor.dtype == torch.float32 and tensor.layout == torch.strided and tensor.is_contiguous()
        return dense and bool(tensor.isfinite().all())

    return {name: tuple(tensor.shape) if plain(tensor) else None for name, tensor in tensors.items()}
