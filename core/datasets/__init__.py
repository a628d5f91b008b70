# SPDX-License-Identifier: GPL-3.0-or-later
"""Datasets of photographs: format detection, parsing, undistortion, masks, the object's bound, and ground truth next to the images."""
