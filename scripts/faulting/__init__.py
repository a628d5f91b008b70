# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of faults and hostile input, one module for each group; run by scripts/faults.py."""
