# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts of the extension in the language of Blender's interface; English is in the code, each other language in a package of its own."""

from __future__ import annotations

import bpy

from .german import TEXTS as GERMAN

LANGUAGES = {"de": GERMAN}  # by Blender's code of the language: English text -> translation
CONTEXTS = ("*", "Operator")  # Blender looks up labels and properties in the first, the texts of buttons in the second


def translated(text: str, /, **values: object) -> str:
    """Return a text in the language of the interface.

    Args:
        text: in English; it may have placeholders, such as "Show {name}".
        **values: of the placeholders.
    """
    text = bpy.app.translations.pgettext_iface(text)
    return text.format(**values) if values else text


def entries() -> dict[str, dict[tuple[str, str], str]]:
    """Return all translations as Blender wants them: by language, then by context and English text."""
    return {
        language: {(context, text): translation for text, translation in texts.items() for context in CONTEXTS}
        for language, texts in LANGUAGES.items()
    }


def register() -> None:
    """Register the translations with Blender, which also translates labels, names and tooltips by them."""
    bpy.app.translations.register(__name__, entries())


def unregister() -> None:
    """Unregister the translations."""
    bpy.app.translations.unregister(__name__)
