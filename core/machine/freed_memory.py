# SPDX-License-Identifier: GPL-3.0-or-later
"""Freed memory that the process keeps for the next allocation.

glibc takes blocks above 128 kB from the system and gives them back when they are freed. The system then clears their pages every time:
a step of the first stage spent a tenth of its time in that.
"""

from __future__ import annotations

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # parameters of mallopt, from malloc.h
LARGEST_BLOCK = 32 << 20  # bytes; larger blocks are still given back at once; glibc allows no larger value
MOST_KEPT = 256 << 20  # bytes kept at the end of the heap


def keep_freed_memory() -> bool:
    """Keep freed memory for the next allocation from now on; return False where the C library has no such setting."""
    if not sys.platform.startswith("linux"):
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    return mallopt is not None and bool(mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK)) and bool(mallopt(M_TRIM_THRESHOLD, MOST_KEPT))
