# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of both stages: optimiser, training views, losses, time budget, skip rules, previews and checks for non-finite values."""
