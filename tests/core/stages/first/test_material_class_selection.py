# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice of the material class is told in words that do not read as a mistake."""

import pytest
from irgspp.core.stages.first.material_class_selection import _choice_in_words


@pytest.mark.parametrize(
    ("score", "chosen", "text"),
    [
        (
            {"low-gloss": 33.37, "glossy": 33.70},
            "low-gloss",
            "materials: low-gloss; glossy would be only 0.3 dB better, less than the 0.5 dB that it needs",
        ),
        ({"low-gloss": 30.0, "glossy": 33.0}, "glossy", "materials: glossy, by 3.0 dB the best on held-back photographs"),
        (
            {"low-gloss": 33.0, "glossy": 30.0, "metal": 32.0},
            "low-gloss",
            "materials: low-gloss, by 1.0 dB the best on held-back photographs",
        ),
        ({"low-gloss": 30.0, "glossy": 33.0, "metal": 33.2}, "glossy", "materials: glossy; metal would be only 0.2 dB better"),
    ],
)
def test_the_choice_and_its_reason(score, chosen, text):
    assert _choice_in_words(score, chosen, 0.5).startswith(text)
