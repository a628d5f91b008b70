# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults and hostile input, group by group; run by scripts/faults.py."""
