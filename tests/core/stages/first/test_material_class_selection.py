# SPDX-License-Identifier: GPL-3.0-or-later
"""Glossy is chosen unless another class is clearly better, or the object clearly reflects; the reason is told in plain words."""

import pytest
from irgspp.core.stages.first.material_class_selection import _choice_in_words, _choose, _margins


@pytest.mark.parametrize(
    ("score", "turns", "chosen", "text"),
    [
        ({"low-gloss": 33.7, "glossy": 33.4}, False, "glossy", "low-gloss would be only 0.3 dB better, less than the 0.5 dB"),
        ({"low-gloss": 34.0, "glossy": 33.4}, False, "low-gloss", "by 0.6 dB the best"),
        ({"low-gloss": 30.0, "glossy": 33.0}, False, "glossy", "by 3.0 dB the best"),
        ({"low-gloss": 33.0, "glossy": 30.0, "metal": 32.0}, False, "low-gloss", "by 1.0 dB the best"),
        ({"low-gloss": 31.5, "glossy": 33.0, "metal": 33.2}, False, "glossy", "metal would be only 0.2 dB better"),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 32.7}, False, "metal", "glossy would be only 0.3 dB better, less than the 0.5 dB"),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 32.7}, True, "glossy", "by 0.3 dB the best"),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 32.4}, False, "glossy", "by 0.6 dB the best"),
        ({"glossy": 33.0, "metal": 33.2}, False, "glossy", "metal would be only 0.2 dB better"),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 33.6}, False, "metal", "by 0.6 dB the best"),
        ({"low-gloss": 33.0, "glossy": 34.4}, True, "low-gloss", "glossy would be only 1.4 dB better, less than the 1.5 dB"),
        ({"low-gloss": 33.0, "glossy": 34.6}, True, "glossy", "by 1.6 dB the best"),
    ],
)
def test_the_choice_and_its_reason(score, turns, chosen, text):
    margins = _margins(0.5, turns)
    assert _choose(score, margins, turns) == chosen
    words = _choice_in_words(score, chosen, margins)
    assert words.startswith(f"materials: {chosen}") and text in words
