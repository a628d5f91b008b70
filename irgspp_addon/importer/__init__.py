# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of datasets and runs into Blender: cameras, meshes, materials, point clouds, and their placement in the scene."""
