# SPDX-License-Identifier: GPL-3.0-or-later
"""Command-line arguments of jobs, from the values of panels and operators."""

import shlex

from ..core.errors import InputError


def capture_words(metres: float, turntable: str) -> list[str]:
    """Return command-line arguments for the size of a marker in metres, 0 for none, and for a turntable: auto, on or off."""
    words = ["--set", f"capture.marker={metres:.6g}"] if metres > 0 else []
    return words + (["--set", f"capture.turntable={turntable}"] if turntable != "auto" else [])


def set_words(settings: str) -> list[str]:
    """Return command-line arguments for `key=value key=value`; raise InputError where quotation marks don't match."""
    try:
        return [word for setting in shlex.split(settings) for word in ("--set", setting)]
    except ValueError as error:
        raise InputError(f"settings {settings!r}", f"can't be read ({error})", "write key=value, separated by spaces") from error
