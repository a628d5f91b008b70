# SPDX-License-Identifier: GPL-3.0-or-later
"""German texts: English text -> translation."""

from . import operators, panels, preferences, properties

TEXTS = {**panels.TEXTS, **operators.TEXTS, **preferences.TEXTS, **properties.TEXTS}
