# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of a job: the interface that stages report to, terminal output, and the event log in a folder."""
