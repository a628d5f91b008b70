# SPDX-License-Identifier: GPL-3.0-or-later
"""Multi-view stereo on the CPU: a depth map of each view by PatchMatch, and their fusion into oriented points."""
