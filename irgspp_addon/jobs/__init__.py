# SPDX-License-Identifier: GPL-3.0-or-later
"""Background jobs of the engine: the queue, their processes, their state on disk, and the import of their results."""
