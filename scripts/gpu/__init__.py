# SPDX-License-Identifier: GPL-3.0-or-later
"""Measurements of scripts/gpu_check.py and their test scene."""
