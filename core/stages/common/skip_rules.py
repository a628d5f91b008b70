# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules that leave out work a scene does not need: decided by evidence, unless the settings decide."""

from __future__ import annotations

from ...progress.protocol import Progress
from ...settings.schema import SkipSettings


def decide(settings: SkipSettings, rule: str, found: bool, evidence: str, progress: Progress) -> bool:
    """True where a rule is in force: `found` says what the scene's own figures, in `evidence`, speak for; "on" and "off" overrule them.

    `progress` is told, so that the run has it on record.
    """
    choice = getattr(settings, rule)
    on = found if choice == "auto" else choice == "on"
    progress.decided(rule, on, evidence if choice == "auto" else f"as set; {evidence}")
    return on
