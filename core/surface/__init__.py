# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface extraction: TSDF fusion, meshing, UV unwrapping, material fusion and texture baking."""
