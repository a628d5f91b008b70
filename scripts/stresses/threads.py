# SPDX-License-Identifier: GPL-3.0-or-later
"""Number of threads of the kernels and of torch within a block."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def threads_set_to(threads: int) -> Iterator[None]:
    """Run the kernels and torch with some number of threads within the block."""
    before, torch_before = os.environ.get("IRGSPP_THREADS"), torch.get_num_threads()
    os.environ["IRGSPP_THREADS"] = str(threads)
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(torch_before)
        os.environ.pop("IRGSPP_THREADS")
        if before is not None:
            os.environ["IRGSPP_THREADS"] = before
