# SPDX-License-Identifier: GPL-3.0-or-later
"""Example of docs/architecture.md, "to add a language": two texts in French."""

import blender_side  # noqa: F401  (before what imports bpy)
from irgspp.irgspp_addon import translations

# --- irgspp_addon/translations/french/__init__.py

TEXTS = {"1 Photographs": "1 Photos", "Show {name}": "Montrer {name}"}


def test_blender_gets_the_texts_by_language_and_context(monkeypatch):
    monkeypatch.setitem(translations.LANGUAGES, "fr", TEXTS)
    entries = translations.entries()
    assert set(entries) == {"de", "fr"} and len(entries["fr"]) == len(TEXTS) * len(translations.CONTEXTS)
    assert entries["fr"]["*", "1 Photographs"] == entries["fr"]["Operator", "1 Photographs"] == "1 Photos"
