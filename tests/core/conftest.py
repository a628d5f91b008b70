# SPDX-License-Identifier: GPL-3.0-or-later
"""What works on a tensor of the CPU: numba, and in its place warp, whose kernels are those of GPUs."""

from collections.abc import Iterator

import pytest
from irgspp.core.machine.backend import warp_on_cpu


@pytest.fixture(params=["numba", "warp"])
def engine(request: pytest.FixtureRequest) -> Iterator[str]:
    if request.param == "numba":
        yield request.param
        return
    pytest.importorskip("warp")
    with warp_on_cpu():
        yield request.param
