# SPDX-License-Identifier: GPL-3.0-or-later
"""Refinement of materials, light and normals on single pixels, and how sure its materials are."""
