# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain float64 references of the kernels, in torch with autograd; the tests compare the fast kernels with them."""
