# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernels for NVIDIA GPUs, in warp's language; warp's CPU device runs them too, for tests. Needs the extra `cuda`."""
