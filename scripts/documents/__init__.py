# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures and pages of the documentation that are made from the code."""
