# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluation of a run: metrics against ground truth by published protocols, reports, contact sheet, comparison with Cycles."""
