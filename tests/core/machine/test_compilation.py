# SPDX-License-Identifier: GPL-3.0-or-later
"""Notice of compilation."""

import numba
from irgspp.core.machine.compilation import compilation_announced


def test_first_compilation_is_announced_once():
    told = []
    double, triple = numba.njit(lambda x: 2 * x), numba.njit(lambda x: 3 * x)
    with compilation_announced(lambda: told.append("compiling")):
        assert not told
        assert (double(2), triple(2), double(3)) == (4, 6, 6)
    assert told == ["compiling"]
    double(1.5)
    assert told == ["compiling"]


def test_compiled_code_is_not_announced():
    told, half = [], numba.njit(lambda x: x / 2)
    half(4)
    with compilation_announced(lambda: told.append("compiling")):
        assert half(6) == 3
    assert not told
