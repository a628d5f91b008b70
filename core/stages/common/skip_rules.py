# SPDX-License-Identifier: GPL-3.0-or-later
"""Skip rules: work that a scene does not need is left out, decided by measured evidence unless the settings decide."""

from __future__ import annotations

from ...progress.protocol import Progress
from ...settings.schema import SkipSettings


def decide_skip_rule(settings: SkipSettings, rule: str, found: bool, evidence: str, progress: Progress) -> bool:
    """Decide whether a skip rule is in force, and report the decision to `progress`, which records it with the run.

    Args:
        settings: choice per rule: "auto", "on" or "off".
        rule: name of the rule, a field of `SkipSettings`.
        found: decision that the scene's own measurements suggest; "on" and "off" overrule it.
        evidence: these measurements in words.
        progress: receives the decision.

    Returns:
        True where the rule is in force.
    """
    choice = getattr(settings, rule)
    on = found if choice == "auto" else choice == "on"
    progress.decided(rule, on, evidence if choice == "auto" else f"as set; {evidence}")
    return on
