# SPDX-License-Identifier: GPL-3.0-or-later
"""Example of docs/architecture.md, "to add a kernel": weighted sums over segments, on threads, with gradient and float64 reference."""

from itertools import pairwise

import numpy as np
import torch
from irgspp.core.kernels.cpu.jit import kernel
from irgspp.core.machine.thread_pool import even_ranges, run_ranges, thread_count

# --- core/kernels/cpu/segments.py: loops over a range, without allocation


@kernel
def sum_range(begin, end, start, weight, value, out):
    """Segments begin..end: out[s] = sum of weight * value over the segment."""
    for s in range(begin, end):
        total = np.float32(0.0)
        for i in range(start[s], start[s + 1]):
            total += weight[i] * value[i]
        out[s] = total


# --- core/kernels/segments.py: the public function, differentiable in `value`


class _SegmentSum(torch.autograd.Function):
    @staticmethod
    def forward(ctx, value, weight, start):
        ctx.save_for_backward(weight, start)
        out = torch.empty(len(start) - 1)
        arrays = (start.numpy(), weight.numpy(), value.detach().contiguous().numpy(), out.numpy())
        run_ranges(sum_range, even_ranges(len(out), 4 * thread_count()), *arrays)
        return out

    @staticmethod
    def backward(ctx, gradient):
        weight, start = ctx.saved_tensors
        return weight * gradient.repeat_interleave(start.diff()), None, None


def segment_sum(value, weight, start):
    """Sum weight * value over segments: value, weight (N,) float32; start (S + 1,) int64; returns (S,)."""
    return _SegmentSum.apply(value, weight, start)


# --- core/kernels/reference/segments.py: the definition, float64, any gradient by autograd


def segment_sum_reference(value, weight, start):
    return torch.stack([(weight[a:b] * value[a:b]).sum() for a, b in pairwise(start)])


def test_values_and_gradients_are_those_of_the_reference():
    random = np.random.default_rng(3)
    start = torch.from_numpy(np.concatenate([[0], np.cumsum(random.integers(0, 7, 300))]))
    value, weight = (torch.from_numpy(random.normal(size=int(start[-1]))) for _ in range(2))
    upstream = torch.from_numpy(random.normal(size=300))
    fast, exact = value.float().requires_grad_(), value.clone().requires_grad_()
    segment_sum(fast, weight.float(), start).backward(upstream.float())
    segment_sum_reference(exact, weight, start).backward(upstream)
    assert torch.allclose(segment_sum(fast, weight.float(), start).double(), segment_sum_reference(exact, weight, start), atol=1e-5)
    assert torch.allclose(fast.grad.double(), exact.grad, atol=1e-5)
