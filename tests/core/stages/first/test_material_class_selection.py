# SPDX-License-Identifier: GPL-3.0-or-later
"""Glossy is chosen unless another class is clearly better, or the object clearly reflects; the reason is told in plain words."""

import pytest
from irgspp.core.stages.first.material_class_selection import _choice_in_words, _choose, _margins


@pytest.mark.parametrize(
    ("score", "turns", "chosen", "text"),
    [
        ({"low-gloss": 33.7, "glossy": 33.4}, False, "glossy", "low-gloss would be only 0.3 dB better, less than the 0.5 dB"),
        ({"low-gloss": 34.0, "glossy": 33.4}, False, "low-gloss", "0.6 dB better than the next"),
        ({"low-gloss": 30.0, "glossy": 33.0}, False, "glossy", "3.0 dB better than the next"),
        ({"low-gloss": 33.0, "glossy": 30.0, "metal": 32.0}, False, "low-gloss", "1.0 dB better than the next"),
        ({"low-gloss": 31.5, "glossy": 33.0, "metal": 33.2}, False, "glossy", "metal would be only 0.2 dB better"),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 32.7}, False, "metal", "glossy would be only 0.3 dB better, less than the 0.5 dB"),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 32.7}, True, "glossy", "0.3 dB better than the next"),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 32.4}, False, "glossy", "0.6 dB better than the next"),
        ({"glossy": 33.0, "metal": 33.2}, False, "glossy", "metal would be only 0.2 dB better"),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 33.6}, False, "metal", "0.6 dB better than the next"),
        ({"low-gloss": 33.0, "glossy": 34.4}, True, "low-gloss", "glossy would be only 1.4 dB better, less than the 1.5 dB"),
        ({"low-gloss": 33.0, "glossy": 34.6}, True, "glossy", "1.6 dB better than the next"),
        ({"low-gloss": 32.0, "glossy": 33.4, "metal": 33.8}, True, "glossy", "metal would be only 0.4 dB better, less than the 1.5 dB"),
    ],
)
def test_the_choice_and_its_reason(score, turns, chosen, text):
    margins = _margins(0.5, turns)
    assert _choose(score, margins, turns) == chosen
    words = _choice_in_words(score, chosen, margins)
    assert words.startswith(f"materials: {chosen}") and text in words
