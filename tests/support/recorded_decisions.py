# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress that keeps what a selection decides."""

from irgspp.core.progress.protocol import Silent


class RecordedDecisions(Silent):
    """Decisions by rule, as (on, evidence), and phases as (name, steps)."""

    def __init__(self):
        self.found, self.phases = {}, []

    def decided(self, rule, on, evidence):
        self.found[rule] = on, evidence

    def phase(self, name, steps):
        self.phases.append((name, steps))
