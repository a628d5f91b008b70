# SPDX-License-Identifier: GPL-3.0-or-later
"""Assets of a finished run: export to GLB, .blend, PLY and EXR, and baking of the mesh's textures again."""
