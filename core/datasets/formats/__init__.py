# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers of the dataset formats, one module each."""
