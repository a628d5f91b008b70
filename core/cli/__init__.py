# SPDX-License-Identifier: GPL-3.0-or-later
"""Command line `irgspp`: options, commands, and their exit statuses."""
