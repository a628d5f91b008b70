# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of options: units are understood, and nonsense gets a line."""

from argparse import ArgumentTypeError

import pytest
from irgspp.core.cli.option_values import count, decimal_words, distance, length, positive, seconds, texels
from irgspp.core.cli.parser import parser
from irgspp.core.errors import InputError


def test_units():
    assert [texels(text) for text in ("2k", "8K", "300")] == [2048, 8192, 300]
    assert [seconds(text) for text in ("90", "90s", "1.5m", "2h")] == [90, 90, 90, 7200]
    assert [length(text) for text in ("50mm", "5cm", "0.05 m")] == pytest.approx([0.05] * 3)
    assert positive("3") == 3 and count("0") == 0


@pytest.mark.parametrize(
    ("parse", "text"),
    [(texels, "0"), (texels, "2m"), (seconds, "5d"), (seconds, "-5"), (length, "5"), (length, "0cm"), (positive, "0"), (count, "-1")],
)
def test_what_is_refused(parse, text):
    with pytest.raises(ArgumentTypeError, match=text):
        parse(text)


def test_small_negative_numbers_are_no_options():
    words = ["capture", "d", "--sphere", "1e-3", "-1.25e-05", "-3E2", "-0.5", "-e5", "-1e", "--set", "seed=-1e-5"]
    assert decimal_words(words) == [*words[:4], "-0.0000125", "-300", *words[6:]]
    args = parser().parse_args(decimal_words(words[:7]))
    assert args.sphere == [1e-3, -1.25e-5, -300, -0.5]


def test_a_distance_is_two_points_and_a_length():
    assert distance(["0", "-1", "2.5", "1e-3", "0", "0", "12cm"]) == (([0, -1, 2.5], [1e-3, 0, 0]), 0.12)
    for words in (["0", "0", "0", "1", "0", "x", "12cm"], ["0", "0", "0", "1", "0", "0", "12"]):
        with pytest.raises(InputError, match="--distance"):
            distance(words)
