# SPDX-License-Identifier: GPL-3.0-or-later
"""Stand-ins for published datasets: which scenes, under which lights, in which layout."""
