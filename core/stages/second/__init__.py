# SPDX-License-Identifier: GPL-3.0-or-later
"""Second stage: light-material solver, assignment of materials to Gaussians, refinement by the rendering equation, radiance refit."""
