# SPDX-License-Identifier: GPL-3.0-or-later
"""Joint optimisation of geometry, radiance, materials and light: the second stage as IRGS++ publishes it."""
