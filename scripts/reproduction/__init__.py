# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of published results with rows measured here: scenes, published rows, and formats of the tables."""
