# SPDX-License-Identifier: GPL-3.0-or-later
"""Warp kernels: the operations on NVIDIA GPUs, in NVIDIA Warp's language; Warp's CPU device runs them in tests. Needs the extra `cuda`."""
