# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that is freed and taken again is not cleared by the system each time."""

import subprocess
import sys

import pytest

SCRIPT = """
import resource
import numpy as np
from irgspp.core.machine.freed_memory import keep_freed_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        np.empty(8 << 20, np.uint8).fill(1)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

print(faults(), keep_freed_memory(), faults())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a setting of glibc")
def test_memory_is_reused():
    before, kept, after = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True).stdout.split()
    assert kept == "True"
    assert int(after) < int(before) / 5
