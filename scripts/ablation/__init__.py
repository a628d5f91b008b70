# SPDX-License-Identifier: GPL-3.0-or-later
"""Ablations of the paper: variants of relighting one finished run, and of training."""
