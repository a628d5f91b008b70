# SPDX-License-Identifier: GPL-3.0-or-later
"""Capture: from bare photographs or a video to a dataset with cameras, masks, exposures and true size."""
