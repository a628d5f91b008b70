# SPDX-License-Identifier: GPL-3.0-or-later
"""Two-stage optimisation: geometry and radiance first, then environment light and materials; shared parts; results between phases."""
