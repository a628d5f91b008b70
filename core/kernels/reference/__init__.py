# SPDX-License-Identifier: GPL-3.0-or-later
"""Float64 references of the kernels in plain PyTorch with autograd, by brute force; tests compare the kernels with them."""
