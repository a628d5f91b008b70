# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU kernels: numba functions over ranges of items, with 8-wide vectors, each run by a pool of threads (core/machine/thread_pool.py)."""
