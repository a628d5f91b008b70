# SPDX-License-Identifier: GPL-3.0-or-later
"""Examples of how the code is extended; docs/architecture.md explains them."""
