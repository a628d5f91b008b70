# SPDX-License-Identifier: GPL-3.0-or-later
"""First stage: initialisation, material class selection and optimisation of 2D Gaussians from the images."""
