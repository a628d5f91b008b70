# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of command-line options: text to numbers; what cannot be read gets argparse's line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from decimal import Decimal

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


def length(text: str) -> float:
    """Parse a length such as 50mm, 5cm or 0.05m to metres."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(mm|cm|m)", text)
    if match is None or float(match[1]) == 0:
        raise argparse.ArgumentTypeError(f"{text} is not a length such as 50mm, 5cm or 0.05m")
    return float(match[1]) * {"mm": 0.001, "cm": 0.01, "m": 1.0}[match[2]]
