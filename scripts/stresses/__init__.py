# SPDX-License-Identifier: GPL-3.0-or-later
"""The cases of the numerical stress test, a module for each group; importing one registers its cases."""
