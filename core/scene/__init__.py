# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene data and their files: cameras, datasets, 2D Gaussians, G-buffers, surfaces, meshes, textures and environment maps."""
