# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of command-line options: text to numbers; what cannot be read gets argparse's line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from decimal import Decimal

from ..errors import InputError

NEGATIVE = re.compile(r"-(\d+\.?\d*|\.\d+)[eE][-+]?\d{1,3}")


def decimal_words(words: Sequence[str]) -> list[str]:
    """Return command-line words with negative numbers such as -1e-05 written out, which argparse takes for an option.

    Args:
        words: after `irgspp`.
    """
    return [format(Decimal(word), "f") if NEGATIVE.fullmatch(word) else word for word in words]


def positive(text: str) -> int:
    """Parse a whole number of at least 1."""
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} must be at least 1")
    return int(text)


def positive_factor(text: str) -> float:
    """Parse a finite number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} must be above 0")
    return value


def texels(text: str) -> int:
    """Parse a texture size such as 2k or 2048 to texels along a side."""
    match = re.fullmatch(r"(\d+)(k?)", text.lower())
    if match is None or int(match[1]) < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a texture size such as 2k or 2048")
    return int(match[1]) * (1024 if match[2] else 1)


def count(text: str) -> int:
    """Parse a whole number of at least 0."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} must be at least 0")
    return value


def seconds(text: str) -> float:
    """Parse a duration such as 90s, 5m or 1h to seconds."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smh]?)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text} is not a duration such as 90s, 5m or 1h")
    return float(match[1]) * {"": 1, "s": 1, "m": 60, "h": 3600}[match[2]]


def distance(words: Sequence[str]) -> tuple[tuple[list[float], list[float]], float]:
    """Parse X Y Z X Y Z LENGTH to two points and their distance in metres.

    Args:
        words: 7.

    Raises:
        InputError: if a word is no number, or the last one no length.
    """
    try:
        numbers, metres = [float(word) for word in words[:6]], length(words[6])
    except (ValueError, argparse.ArgumentTypeError) as error:
        raise InputError("--distance", str(error), "give X Y Z of both ends, and their distance such as 12cm") from error
    return (numbers[:3], numbers[3:]), metres


def length(text: str) -> float:
    """Parse a length such as 50mm, 5cm or 0.05m to metres."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(mm|cm|m)", text)
    if match is None or float(match[1]) == 0:
        raise argparse.ArgumentTypeError(f"{text} is not a length such as 50mm, 5cm or 0.05m")
    return float(match[1]) * {"mm": 0.001, "cm": 0.01, "m": 1.0}[match[2]]
